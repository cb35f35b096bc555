"""The tests mirror the packages. `check` is what verifies shapes and types under pytest (pyproject.toml)."""

from beartype import BeartypeConf, beartype

# To mypy an int is a float; so it is to beartype here.
check = beartype(conf=BeartypeConf(is_pep484_tower=True))
