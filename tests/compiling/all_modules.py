"""All modules of the package loaded, so that all kernels are known."""

import importlib
import pkgutil

import heartcase


def import_all() -> None:
    """Load every module but those for a GPU."""
    for module in pkgutil.walk_packages(heartcase.__path__, "heartcase."):
        if "cuda" not in module.name and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
