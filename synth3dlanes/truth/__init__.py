"""World and View -> Labels."""
