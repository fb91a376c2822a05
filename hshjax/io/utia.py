"""Anisotropic materials of the UTIA BRDF database, `.bin`: a table over the angles of both directions.

    3 planes (red, green, blue) of 288 x 288 float64, little-endian, without a header: 1 990 656 bytes

A row of a plane is a direction of incidence, a column one of view; θ = 0, 15, ... 75 degrees is the slow index of each,
φ = 0, 7.5, ... 352.5 degrees the fast one. Values are taken as linear RGB in sr^-1, without the cosine: the database
calls them BRDF values and its own lookup scales them by nothing. Which direction φ = 0 has on the sample is not said.

Source: Filip and Vávra, Template-Based Sampling of Anisotropic BRDFs, Computer Graphics Forum 33(7), 2014 (steps), and
the lookup that comes with the database (order of planes, rows and columns). Originals were not at hand: files of this
layout were written by independent code.
"""

from os import PathLike

import jax.numpy as jnp
import numpy as np

from hshjax.brdfs import AngleTable
from hshjax.io._binary import file_size, finite_doubles
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import LARGEST, Findings, Measured, Negatives, check_negatives

THETA = np.radians(15.0 * np.arange(6))
PHI = np.radians(7.5 * np.arange(48))
CHANNELS = 3
NODES = (THETA.size * PHI.size) ** 2
SIZE = 8 * CHANNELS * NODES


def sniff(head: bytes, size: int) -> bool:
    """Whether a file of `size` bytes may be of this format, which has no header: its size says so, and `head` holds
    numbers that can be values of a BRDF.
    """
    values = np.frombuffer(head[: len(head) // 8 * 8], "<f8")
    return size == SIZE and bool(np.all(np.isfinite(values) & (np.abs(np.nan_to_num(values)) <= LARGEST)))


def read_utia(path: str | PathLike, *, negatives: Negatives = "keep") -> AngleTable:
    """The data of `measured_utia`."""
    data = measured_utia(path, negatives=negatives).data
    assert isinstance(data, AngleTable)
    return data


def measured_utia(path: str | PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The material as an `AngleTable`, channels R, G, B, in the default float of jax's configuration.

    Beyond 75 degrees, the last elevation, the nearest one holds; the database's own lookup draws a line through the
    last two. `negatives`: "mask" makes a node with a negative value in any channel count as unmeasured.

    **Raises:** FileFormatError for a file of another size, before it is read; for values that are not finite, or beyond
    1e30, as those of the other byte order; ValueError for another word in `negatives`; OSError where the file cannot be
    opened.
    """
    check_negatives(negatives)
    size = file_size(path)
    if size != SIZE:
        expected = f"{SIZE} bytes, {CHANNELS} planes of 288 x 288 float64"
        raise FileFormatError(path, "size", expected, f"{size}" if size else "an empty file")
    planes = finite_doubles(path, 0, CHANNELS * NODES)
    huge = np.abs(planes) > LARGEST
    if huge.any():
        first = int(np.argmax(huge))
        expected = f"at most {LARGEST:g} (another byte order?)"
        raise FileFormatError(path, f"byte {8 * first}, value {first}", expected, f"{planes[first]:g}")
    values = np.moveaxis(planes.reshape(CHANNELS, THETA.size, PHI.size, THETA.size, PHI.size), 0, -1)
    negative = (values < 0).any(axis=-1)
    measured, masked, notes = None, {}, []
    if negative.any() and negatives == "clip":
        values = np.maximum(values, 0)
        notes.append("Negative values became 0.")
    elif negative.any() and negatives == "mask":
        measured, masked = jnp.asarray(~negative), {"a negative value": int(negative.sum())}
    notes.append("Values are taken as linear RGB in sr^-1, cosine not included.")
    notes.append("Beyond 75 degrees the nearest elevation holds.")
    dtype = jnp.result_type(float)
    theta, phi = jnp.asarray(THETA, dtype), jnp.asarray(PHI, dtype)
    table = AngleTable(
        values=jnp.asarray(values, dtype), theta_i=theta, phi_i=phi, theta_o=theta, phi_o=phi, measured=measured
    )
    found = Findings(
        "UTIA BRDF",
        "",
        ("R", "G", "B"),
        "not declared: taken as sr^-1",
        NODES,
        masked=masked,
        negative=int(negative.sum()),
        notes=tuple(notes),
    )
    return Measured(table, found)
