"""Numbers in sentences."""


def counted(n: int, noun: str, plural: str = "") -> str:
    """`1 sample`, `2 samples`, `1,500 samples`."""
    return f"{n:,} {noun if n == 1 else plural or f'{noun}s'}"


def sized(n_bytes: float, digits: int = 2) -> str:
    """`83 kB`, `1.2 MB`, `120 GB`: the first digits of a size."""
    for unit, size in (("kB", 1e3), ("MB", 1e6), ("GB", 1e9)):
        shown = float(f"{n_bytes / size:.{digits}g}")
        if shown < 1000:
            return f"{shown:g} {unit}"
    return f"{n_bytes / 1e12:.{digits}g} TB"
