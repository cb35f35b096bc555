"""Pictures, tables and pages for people; nothing else in the project depends on them."""
