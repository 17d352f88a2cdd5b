"""What must be refused, and the place that is named."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from moteslam.errors import MoteslamError


@contextmanager
def refusal(
    error: type[MoteslamError] | tuple[type[MoteslamError], ...], match: str | None = None, **place: object
) -> Iterator[pytest.ExceptionInfo[MoteslamError]]:
    """As ``pytest.raises``, of an error in one line whose ``file``, ``line`` and ``field`` are as given."""
    with pytest.raises(error, match=match) as caught:
        yield caught
    found = {name: str(getattr(caught.value, name)) for name in place}
    assert found == {name: str(value) for name, value in place.items()}
    assert "\n" not in str(caught.value)
