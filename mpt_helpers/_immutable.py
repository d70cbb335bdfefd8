"""The base class of models and filters: immutable, compared by value. And the types that help shows of results."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from typing import Any, TypeVar

import numpy as np

ResultClass = TypeVar("ResultClass", bound=type)


def types_as_written(cls: ResultClass) -> ResultClass:
    """Let help show the types of a NamedTuple as the source has them: 'Array' instead of ForwardRef('Array')."""
    written = {name: each.__forward_arg__ for name, each in cls.__annotations__.items()}
    cls.__annotations__ = cls.__new__.__annotations__ = written
    return cls


class Immutable:
    """A frozen dataclass whose fields are numbers, arrays and other immutable values.

    Instances of one class are equal, with equal hashes, if all their fields are equal, those of `field(compare=False)`
    left out; NaN equals NaN. Copies and pickles go through the constructor, since numpy does not keep the read-only
    flag.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(map(same, self._held(), other._held()))

    def __hash__(self) -> int:
        # Arrays by their bytes; adding 0.0 turns -0.0 into 0.0, which is equal to it.
        held = [(each + 0.0).tobytes() if isinstance(each, np.ndarray) else each for each in self._held()]
        return hash((type(self), *held))

    def _held(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self) if field.compare]

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **{field.name: getattr(self, field.name) for field in fields(self)}), ()


def same(a: object, b: object) -> bool:
    """Tell whether two fields are equal; arrays are if all their entries are.

    >>> same(np.array([1.0, np.nan]), np.array([1.0, np.nan])), same(1.0, None)
    (True, False)
    """
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    return bool(type(a) is type(b) and a == b)
