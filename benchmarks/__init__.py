"""Speed against accuracy, in development only: benchmarks, studies, the documentation's charts; not in the wheel."""
