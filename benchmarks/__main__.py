"""Every benchmark in turn, each in a process of its own: `python -m benchmarks [--smoke]`, or `make bench`."""

import pkgutil
import subprocess
import sys

import benchmarks
from benchmarks._smoke import parser

chosen = parser(__doc__).parse_args()
names = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_"))
for name in names:
    print(f"== benchmarks.{name}", flush=True)
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}", *(["--smoke"] if chosen.smoke else [])], check=True)
