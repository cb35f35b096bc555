"""Numbers in sentences."""


def counted(n: int, noun: str, plural: str = "") -> str:
    """`1 sample`, `2 samples`, `1,500 samples`."""
    return f"{n:,} {noun if n == 1 else plural or f'{noun}s'}"
