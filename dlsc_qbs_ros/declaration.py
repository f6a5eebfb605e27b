"""How a parameter is declared, and what a value of it has to be."""

from __future__ import annotations

from dataclasses import Field, field, fields
import math
from typing import Any

from .errors import ConfigError


def parameter(default, meaning: str, *, unit: str = '', bounds: tuple = (), choices: tuple = (),
              live: bool = False):
    """
    Declare one parameter: inclusive `bounds` for numbers, `choices` for words.

    One that is `live` may change while a node runs; it is read wherever it is used.
    """
    return field(default=default, metadata={
        'meaning': meaning, 'unit': unit, 'bounds': bounds, 'choices': choices, 'live': live})


class Section:
    """
    A group of parameters; values are checked, and integers widened, on construction.

    `fixed_by` says in words why those of its parameters that are not live cannot change.
    """

    fixed_by = ''

    def __post_init__(self):
        for spec in fields(self):
            value = checked(f'{type(self).name}.{spec.name}', getattr(self, spec.name), spec)
            object.__setattr__(self, spec.name, value)


def checked(name: str, value: Any, spec: Field) -> Any:
    """Return the value as the field's own type, or raise ConfigError with value and bound."""
    wanted = type(spec.default)
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if wanted is tuple and isinstance(value, list):
        value = tuple(value)
    if type(value) is not wanted:
        raise ConfigError(f'{name} = {value!r}: expected {wanted.__name__}')
    if wanted is tuple and not all(isinstance(item, str) for item in value):
        raise ConfigError(f'{name} = {list(value)!r}: expected a list of strings')
    choices, bounds = spec.metadata['choices'], spec.metadata['bounds']
    if choices and value not in choices:
        raise ConfigError(f'{name} = {value!r}: expected one of {", ".join(choices)}')
    if wanted is float and not math.isfinite(value):
        raise ConfigError(f'{name} = {value}: expected a finite number')
    if bounds and not bounds[0] <= value <= bounds[1]:
        raise ConfigError(f'{name} = {value}: expected a value in [{bounds[0]}, {bounds[1]}]')
    return value
