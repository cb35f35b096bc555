"""Pictures, tables and HTML pages for people."""
