"""Options of :func:`ssplat.encode` for research and for divided work, which stand together in one mapping."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, TypedDict, cast

from ._input import whole
from .errors import ParameterError

__all__ = ["Research", "research_options"]


class Research(TypedDict, total=False):
    """The argument ``research`` of :func:`ssplat.encode`, which documents its keys."""

    seed: int
    layout: Literal["coded", "planes", "packed"]
    blend: Literal["normalized", "sum"] | None
    needs: Literal["measured", "everything"]
    start: Callable[[bytes], Callable[[], bytes]] | None
    at_once: int


_DEFAULTS: Research = {
    "seed": 0,
    "layout": "coded",
    "blend": None,
    "needs": "measured",
    "start": None,
    "at_once": 4,
}


def research_options(given: Research | Mapping[str, Any] | None) -> Research:
    """Returns all options: those that are given, and the defaults of the others. Raises a TypeError for a value that is
    no mapping, and a ParameterError for an unknown key."""
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"research: {given!r} is not a mapping")
    for name in given or ():
        if name not in _DEFAULTS:
            known = ", ".join(map(repr, sorted(_DEFAULTS)))
            raise ParameterError(f"bad parameter research: {name!r} is none of {known}", "research")
    options = cast("Research", {**_DEFAULTS, **(given or {})})
    for name in ("layout", "blend", "needs"):
        value = options[name]  # type: ignore[literal-required]
        if not isinstance(value, str) and not (name == "blend" and value is None):
            raise TypeError(f"{name}: {value!r} is not a name")
    options["seed"] = whole("seed", options["seed"])
    options["at_once"] = whole("at_once", options["at_once"])
    return options
