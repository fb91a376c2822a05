"""Environments of peers: made by uv from pinned requirements, kept in a folder of this repository."""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from experiments.peers._errors import PeerUnavailableError

ROOT = Path(__file__).parents[2]

PEERS = {
    "mitsuba": ("mitsuba==3.9.1", "drjit==1.5.0", "numpy==2.4.6"),
    # sphericart-jax takes no newer jax. matplotlib is imported by zernipax.
    "harmonics": (
        "sphericart-jax==2.0.4", "zernipax==0.2.1", "jax==0.10.1", "jaxlib==0.10.1", "scipy==1.17.1", "numpy==2.4.6",
        "matplotlib==3.11.2",
    ),
}  # fmt: skip
"""Requirements by name. Versions that Python 3.11 to 3.13 can have, all of them pinned."""

FOLDER_VARIABLE = "HSHJAX_PEERS"


def folder() -> Path:
    """Where environments are kept: the folder that `HSHJAX_PEERS` names, else `.peers` of the repository."""
    return Path(os.environ.get(FOLDER_VARIABLE) or ROOT / ".peers")


def environment(name: str, *, cache: Path | None = None) -> Path:
    """The Python of a peer's environment, which is made if it is not there.

    It lies in `<name>-<hash of requirements and interpreter>` of `cache` (default: `folder()`): with other requirements
    it is another one. Takes a package index the first time.

    **Raises:** ValueError for an unknown name; PeerUnavailableError where there is no uv, or no index.
    """
    if name not in PEERS:
        raise ValueError(f"unknown peer {name!r}; peers: {', '.join(PEERS)}")
    cache = folder() if cache is None else cache
    version = f"{sys.implementation.name} {sys.version_info.major}.{sys.version_info.minor}"
    digest = hashlib.sha256("\n".join((version, *PEERS[name])).encode()).hexdigest()[:8]
    home = (cache / f"{name}-{digest}").absolute()
    python = home / "bin" / "python"
    if python.exists():  # it follows the link: an interpreter that has gone counts as missing
        return python
    uv = _uv()
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}-", dir=cache) as beside:
        made = Path(beside) / "environment"
        _call(name, uv, "venv", "--quiet", "--relocatable", "--python", sys.executable, str(made))
        _call(name, uv, "pip", "install", "--quiet", "--python", str(made / "bin" / "python"), *PEERS[name])
        if home.exists() and not python.exists():
            shutil.rmtree(home)
        try:
            made.rename(home)
        except OSError:
            if not python.exists():  # otherwise another process was faster
                raise
    return python


def _uv() -> str:
    """uv beside this interpreter, as `make setup` installs it, else of the machine."""
    found = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    if found is None:
        raise PeerUnavailableError("no uv found: `make setup` installs it beside Python, or put one on PATH")
    return found


def _call(name: str, *command: str) -> None:
    # Like the Makefile: nothing but packages is fetched.
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"UV_PYTHON_DOWNLOADS": "never"}
    )
    if done.returncode:
        raise PeerUnavailableError(
            f"the environment of {name} ({', '.join(PEERS[name])}) could not be made. It needs a package index, once, "
            f"and room in the folder that {FOLDER_VARIABLE} names. {command[0]} {command[1]} said:\n"
            f"{done.stderr.strip()[-2000:]}"
        )
