"""Keyword arguments as those of `stgdat predict`, which checks them."""

from __future__ import annotations

import os
from typing import Any, List, Mapping, Optional, Tuple, Union

import numpy as np

Path = Union[str, "os.PathLike[str]"]
Origin = Tuple[float, float]


def written(settings: Optional[Mapping[str, object]] = None, **values: Any) -> List[str]:
    """The arguments. `None` and `False` leave one out, `True` is a flag, and pairs are joined by a comma.

    >>> written({"tracker.associate": True}, lanes="a.osm", no_retrieval=False)
    ['--lanes=a.osm', '--set=tracker.associate=true']
    """
    flags = [_flag("--" + name.replace("_", "-"), value) for name, value in values.items()]
    sets = [f"--set={name}={_text(value)}" for name, value in (settings or {}).items()]
    return [flag for flag in flags if flag is not None] + sets


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
