"""Converts recordings of data sets to stgdat's own CSV: `python -m stgdat.datasets NAME --help`.

`python3 services/offline/python/stgdat/datasets NAME` does the same in a clone, without the wheel.
"""

import os
import sys
from importlib import import_module
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import module_from_spec

NAMES = ("argoverse2_sensor", "nuplan", "nuscenes", "waymo")


def folder_as_package() -> str:
    """Makes this folder a package, without the one around it, which needs the wheel."""
    folder = os.path.dirname(os.path.abspath(__file__))
    loader = SourceFileLoader("datasets", os.path.join(folder, "__init__.py"))
    spec = ModuleSpec("datasets", loader, is_package=True)
    spec.submodule_search_locations = [folder]
    module = module_from_spec(spec)
    sys.modules["datasets"] = module
    loader.exec_module(module)
    return "datasets"


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in NAMES:
        sys.exit(f"usage: python -m stgdat.datasets {{{','.join(NAMES)}}} ...")
    name = sys.argv.pop(1)
    import_module(f"._{name}", __package__ or folder_as_package()).main()
