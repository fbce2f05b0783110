"""Charts and tables of the documentation's pages."""
