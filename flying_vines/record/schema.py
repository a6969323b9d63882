"""JSON schemas of the recorded messages, made from their dataclasses.

Foxglove needs one plain type per field, so an unknown value is left out of its message. The schemas of
msgspec do not fit: they have references, and alternatives with null.
"""

from __future__ import annotations

import types
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from inspect import getdoc
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

Schema = dict[str, Any]

_PLAIN: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}


def obj(properties: Mapping[str, Schema], description: str = "") -> Schema:
    """The schema of an object with these properties; it may have others."""
    schema: Schema = {"type": "object", "properties": dict(properties)}
    if description:
        schema["description"] = description
    return schema


def of_dataclass(kind: type) -> Schema:
    """The schema of a dataclass or named tuple: its fields in order, and the summary of its docstring."""
    hints = get_type_hints(kind)
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(kind.__annotations__)
    return obj({name: of_type(hints[name]) for name in names}, (getdoc(kind) or "").split("\n\n")[0])


def of_type(hint: Any) -> Schema:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        known = [argument for argument in arguments if argument is not type(None)]
        if len(known) == 1:
            return of_type(known[0])
        return merged(of_dataclass(argument) for argument in known)
    if origin is Literal:
        return {"type": "string", "enum": list(arguments)}
    if origin in (list, tuple):
        return {"type": "array", "items": of_type(arguments[0])}
    if origin is dict:
        return obj({})
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return of_dataclass(hint)
    return {"type": next(word for kind, word in _PLAIN.items() if issubclass(hint, kind))}


def merged(alternatives: Iterable[Schema]) -> Schema:
    """The schema of an object that is one of several kinds. It has the properties of all of them."""
    properties: dict[str, Schema] = {}
    for schema in alternatives:
        properties |= schema["properties"]
    return obj(properties)


def of_mavlink(kind: Any) -> Schema:
    """The schema of a message of the pymavlink dialect."""
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    properties = {}
    for name, wire in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if wire == "char":
            field: Schema = {"type": "string"}
        else:
            field = {"type": "number" if wire in ("float", "double") else "integer"}
            if lengths[name]:
                field = {"type": "array", "items": field}
        if unit := kind.fieldunits_by_name.get(name):
            field["description"] = unit
        properties[name] = field
    return obj(properties)
