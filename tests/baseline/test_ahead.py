"""Work of a thread ahead: the same items in the same order, no more of them than asked for, and its errors."""

import pytest
from synth3dlanes_baseline.ahead import ahead


@pytest.mark.parametrize("n", [1, 3])
def test_items_come_in_order_and_few_are_made_ahead(n):
    made = []

    def items():
        for i in range(20):
            made.append(i)
            yield i

    for used, item in enumerate(ahead(items(), n), start=1):
        assert item == used - 1
        assert len(made) <= used + n
    assert made == list(range(20))


def test_an_error_comes_after_the_items_before_it_and_a_reader_may_leave():
    def items():
        yield from range(3)
        raise ValueError("the fourth")

    found = []
    with pytest.raises(ValueError, match="the fourth"):
        found.extend(ahead(items(), 2))
    assert found == [0, 1, 2]
    reading = ahead(items(), 2)
    assert [next(reading), next(reading)] == [0, 1]
    reading.close()
