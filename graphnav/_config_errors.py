"""What is wrong with a configuration, in words of its file and not of the library that checks it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from graphnav._hints import hint
from graphnav.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

#: Type of pydantic's error -> what was expected; in braces what its context tells.
_EXPECTED = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "text",
    "literal_error": "{expected}",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of {ge:g} or more",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of {le:g} or less",
}


def config_error(model: type[BaseModel], error: ValidationError, where: str) -> ConfigError:
    """The first thing that is wrong, with its key, the value found and what was expected.

    Parameters
    ----------
    model : the configuration; where : the file, or what else it is.
    """
    first = error.errors()[0]
    path, kind, value = first["loc"], first["type"], to_toml(first["input"])
    key = ".".join(str(part) for part in path)
    if kind == "extra_forbidden":
        return ConfigError(f"{where}: unknown key {key}; {hint(str(path[-1]), _known(model, path[:-1]))}")
    if kind in ("model_type", "dict_type"):
        return ConfigError(f"{where}: {key}: {value}, expected a section; write its keys under [{key}]")
    expected = _EXPECTED[kind].format(**first.get("ctx", {})) if kind in _EXPECTED else first["msg"]
    return ConfigError(f"{where}: {key}: {value}, expected {expected}")


def to_toml(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _known(model: Any, path: tuple[int | str, ...]) -> list[str]:
    for part in path:
        model = model.model_fields[part].annotation
    return list(model.model_fields)
