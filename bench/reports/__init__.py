"""A report: which runs it needs, its page, pictures and JSON."""
