"""What Mitsuba 3.9.1's `measured` plugin says of random tables: python -m tests.io.measured_reference

Writes `measured_reference.npz` beside this file. Seeds are in the cases; needs the environment of the peer, see
`experiments.peers`.
"""

import tempfile
from pathlib import Path

import numpy as np

from tests.io.tensor_files import packed

FILE = Path(__file__).with_suffix(".npz")
PAIRS = 48
WAVELENGTHS = np.float32([400, 500, 620, 700])

CASES = {
    "isotropic": (np.float32([0]), 3),
    "two azimuths": (np.float32([-2, 1]), 3),
    "a turn": (np.linspace(-np.pi, np.pi, 7).astype(np.float32), 3),
    "half a turn": (np.linspace(-np.pi, 0, 5).astype(np.float32), 3),
    "a quarter": (np.linspace(-np.pi, -np.pi / 2, 3).astype(np.float32), 3),
    "spectral": (np.float32([0]), 4),
    "spectral, a turn": (np.linspace(-np.pi, np.pi, 5).astype(np.float32), 4),
}
"""φ_i and how many channels: R, G, B, or four wavelengths."""


def tables(case: str) -> dict[str, np.ndarray]:
    """Random tables of positive numbers, the elevations unevenly spaced."""
    phi_i, channels = CASES[case]
    rng = np.random.default_rng(list(CASES).index(case))

    def positive(*shape):
        return rng.uniform(0.5, 2, shape).astype(np.float32)

    turns, theta_i = phi_i.size, np.float32([0, 0.4, 0.9, 1.5])
    # Of an isotropic material, areas do not depend on the azimuth; where they do, Mitsuba reads them turned by π.
    sigma = np.repeat(positive(1, 8), 5, axis=0) if turns == 1 else positive(5, 8)
    values = positive(turns, 4, channels, 4, 4)
    coloured = {"spectra": values, "wavelengths": WAVELENGTHS} if channels == 4 else {"rgb": values}
    return {
        "description": np.frombuffer(case.encode(), np.uint8),
        "phi_i": phi_i,
        "theta_i": theta_i,
        "sigma": sigma,
        "ndf": positive(6, 8),
        "vndf": positive(turns, 4, 7, 6),
        "luminance": positive(turns, 4, 4, 4),
        **coloured,
        "jacobian": np.ones(1, np.uint8),
    }


def pairs() -> tuple[np.ndarray, np.ndarray]:
    """wi, wo, uniform above 84 degrees off the normal."""
    rng = np.random.default_rng(99)
    z, phi = rng.uniform(0.1, 1, (2, PAIRS)), rng.uniform(0, 2 * np.pi, (2, PAIRS))
    rim = np.sqrt(1 - z**2)
    wi, wo = np.stack([rim * np.cos(phi), rim * np.sin(phi), z], axis=-1)
    return wi, wo


def main() -> None:
    from experiments.peers import run

    wi, wo = pairs()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            path = Path(folder) / "a.bsdf"
            path.write_bytes(packed(tables(case)))
            inputs = {"path": str(path), "wi": wi, "wo": wo, "variant": "scalar_rgb"}
            if "spectral" in case:
                inputs |= {"variant": "scalar_spectral", "wavelengths": np.tile(WAVELENGTHS, (PAIRS, 1))}
            found[case] = run("mitsuba", "mitsuba_measured", inputs)["value"].astype(np.float32)
    np.savez(FILE, allow_pickle=False, **found)


if __name__ == "__main__":
    main()
