"""Labels as data: what a network must predict from an image."""
