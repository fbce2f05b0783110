"""Speed against accuracy: every choice the software makes, measured against known truth."""
