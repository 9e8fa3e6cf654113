"""Run every benchmark of this package, one after another."""

from importlib import import_module
from pkgutil import iter_modules

import benchmarks

for module in sorted(iter_modules(benchmarks.__path__), key=lambda module: module.name):
    if module.name == "__main__":
        continue
    run = getattr(import_module(f"benchmarks.{module.name}"), "main", None)
    if run is not None:
        print(f"\n== {module.name}")
        run()
