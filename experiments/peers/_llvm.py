"""LLVM's shared library, which Mitsuba's `llvm_*` variants load when they start."""

import ctypes.util
import os
import re
from pathlib import Path

from experiments.peers._environments import folder
from experiments.peers._errors import PeerUnavailableError

VARIABLE = "DRJIT_LIBLLVM_PATH"

VERSIONS = (19, 20, 21, 18, 17)
"""Tried in this order. With Mitsuba 3.9.1, 15 and 16 abort the process ("Cannot select: fmaximum") and 19 works."""

PLACES = ("/usr/lib/*", "/usr/lib", "/usr/lib64", "/usr/lib/llvm*/lib", "/usr/local/lib")


def llvm_library() -> str:
    """What to set DRJIT_LIBLLVM_PATH to: its own value, else a library of a version that works.

    Looks below `llvm/` in the folder of the peers, then at the usual places of Linux, then asks the loader.

    **Raises:** PeerUnavailableError that says what to install.
    """
    if chosen := os.environ.get(VARIABLE):
        if os.sep in chosen and not Path(chosen).is_file():  # a bare name is for the loader to find
            raise PeerUnavailableError(f"{VARIABLE} is {chosen!r}, which is no file")
        return chosen
    own = folder() / "llvm"
    for version in VERSIONS:
        if found := _named(own.rglob("libLLVM*.so*"), version):
            return found
        for place in PLACES:
            if found := _named(Path("/").glob(f"{place[1:]}/libLLVM*.so*"), version):
                return found
        if found := ctypes.util.find_library(f"LLVM-{version}"):  # a bare name, on Linux
            return found
    raise PeerUnavailableError(
        f"no LLVM of versions {', '.join(map(str, sorted(VERSIONS)))} found. Debian: `apt-get install libllvm19`, or "
        f"without root `apt-get download libllvm19 && dpkg -x libllvm19_*.deb {own}`; or name the library, "
        f"libLLVM-19.so, in {VARIABLE}"
    )


def _named(paths, version: int) -> str | None:
    """The first of the libraries whose name says this version: libLLVM-19.so, libLLVM-19.1.so, libLLVM.so.19.1."""
    pattern = re.compile(rf"libLLVM(-{version}(\.\d+)*\.so(\.\d+)*|\.so\.{version}(\.\d+)*)")
    return next((str(path.absolute()) for path in sorted(paths) if pattern.fullmatch(path.name)), None)
