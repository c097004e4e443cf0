"""Keyword arguments as those of `stgdat predict`, which checks them."""

from __future__ import annotations

import os
from typing import Any, List, Mapping, Optional, Tuple, Union

import numpy as np

from . import checks

Path = Union[str, "os.PathLike[str]"]
Origin = Tuple[float, float]


def written(settings: Optional[Mapping[str, object]] = None, **values: Any) -> List[str]:
    """The arguments. `None` and `False` leave one out, `True` is a flag, and pairs are joined by a comma.

    >>> written({"tracker.associate": True}, map="online", no_retrieval=False)
    ['--map=online', '--set=tracker.associate=true']
    """
    values = {name: _checked(name, value) for name, value in values.items()}
    flags = [_flag("--" + name.replace("_", "-"), value) for name, value in values.items()]
    sets = [f"--set={name}={_text(value)}" for name, value in (settings or {}).items()]
    return [flag for flag in flags if flag is not None] + sets


def _checked(name: str, value: Any) -> Any:
    if value is None:
        return None
    if name == "weights":
        return weights_file(value)
    if name == "lanes":
        return checks.existing(value)
    if name in ("seed", "ticks") and (isinstance(value, bool) or not isinstance(value, (int, np.integer))):
        raise TypeError(f"{name} is a whole number, not {type(value).__name__}")
    return value


def weights_file(weights: Path) -> Optional[str]:
    """The file of the weights, or of the shipped weights of this name; `None` for the embedded ones."""
    name = os.fspath(weights)
    if name == "onboard" and not os.path.exists(name):
        return None
    shipped = os.path.join(os.path.dirname(__file__), "weights", name + ".safetensors")
    is_name = os.path.basename(name) == name and not os.path.exists(name)
    return shipped if is_name and os.path.exists(shipped) else checks.existing(name)


def _flag(name: str, value: Any) -> Optional[str]:
    if value is None or value is False:
        return None
    return name if value is True else f"{name}={_text(value)}"


def _text(value: Any) -> str:
    if isinstance(value, (bool, np.bool_)):
        return str(value).lower()
    if isinstance(value, (tuple, list, np.ndarray)):
        return ",".join(map(_text, value))
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)
