# SPDX-License-Identifier: Apache-2.0
"""What the dataclasses share: equality with arrays in them, and checks of what
a caller passed. Checks raise InvalidArgumentError, which names the field."""
from __future__ import annotations

import dataclasses
import enum
import math
import numbers
import re
from typing import Any, Optional, Type, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import bad_argument, unknown_choice

Array = NDArray[np.float64]
E = TypeVar("E", bound=enum.Enum)

_ID = re.compile(r"[A-Za-z0-9._-]{1,64}\Z")
_UINT64_END = 1 << 64


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return a is not None and b is not None and bool(np.array_equal(a, b))
    return bool(a == b)


class Value:
    """Base of frozen dataclasses that hold arrays: equal if all fields are."""

    def __eq__(self, other: object) -> bool:
        if other.__class__ is not self.__class__:
            return NotImplemented
        fields = dataclasses.fields(self)
        return all(_same(getattr(self, f.name), getattr(other, f.name)) for f in fields)

    __hash__ = None  # type: ignore[assignment]


def frozen(array: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A read-only copy."""
    copy = np.array(array, dtype=dtype)
    copy.flags.writeable = False
    return copy


def vector(field: str, value: ArrayLike, size: int) -> Array:
    """`size` finite numbers."""
    try:
        array = frozen(value)
    except (TypeError, ValueError):
        raise bad_argument(field, f"{value!r} is not {size} numbers") from None
    if array.shape != (size,):
        raise bad_argument(field, f"has shape {array.shape}, must be ({size},)")
    if not np.isfinite(array).all():
        raise bad_argument(field, f"{array.tolist()} is not finite")
    return array


def number(field: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise bad_argument(field, f"{value!r} is not a number")
    if not math.isfinite(value):
        raise bad_argument(field, f"{value!r} is not finite")
    return float(value)


def above_zero(field: str, value: Any) -> float:
    result = number(field, value)
    if result <= 0.0:
        raise bad_argument(field, f"{value!r} must be above 0")
    return result


def integer(field: str, value: Any, low: int = 0, high: int = _UINT64_END - 1) -> int:
    """A whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise bad_argument(field, f"{value!r} is not a whole number")
    if not low <= int(value) <= high:
        bound = f"in [{low}, {high}]" if high < _UINT64_END - 1 else f"{low} or more"
        raise bad_argument(field, f"{value!r} must be {bound}")
    return int(value)


def identifier(field: str, value: Any, *, allow_empty: bool = False) -> str:
    """The id of a session or target: 1 to 64 of [A-Za-z0-9._-]."""
    if allow_empty and value == "":
        return ""
    if not isinstance(value, str) or not _ID.match(value):
        raise bad_argument(
            field, f"{value!r} must be 1 to 64 of the characters A-Z a-z 0-9 . _ -"
        )
    return value


def map_name(field: str, value: Any) -> str:
    """As an id, not starting with . or -."""
    if not isinstance(value, str) or not _ID.match(value) or value[0] in ".-":
        raise bad_argument(
            field,
            f"{value!r} must be 1 to 64 of the characters A-Z a-z 0-9 . _ -, "
            "and not start with . or -",
        )
    return value


def choice(field: str, value: Union[str, E], of: Type[E]) -> E:
    """A member of `of`, given as itself or by its value."""
    if isinstance(value, of):
        return value
    try:
        return of(value)
    except ValueError:
        raise unknown_choice(field, value, [str(m.value) for m in of]) from None


def optional_number(field: str, value: Optional[float]) -> Optional[float]:
    return None if value is None else number(field, value)
