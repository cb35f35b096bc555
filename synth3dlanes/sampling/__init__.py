"""How the parts of a scene are drawn; `sample.py` puts them together."""
