"""Every benchmark in turn, each in a process of its own: `python -m benchmarks`, or `make bench`."""

import pkgutil
import subprocess
import sys

import benchmarks

names = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_"))
for name in names:
    print(f"== benchmarks.{name}", flush=True)
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=True)
