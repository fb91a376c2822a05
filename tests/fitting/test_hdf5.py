"""Datasets of HDF5 as source and result of what does not fit in memory, where h5py, which nothing needs, is there."""

import numpy as np
import pytest

from hshjax.bases import HSH
from hshjax.fitting import SampleBlocks, TileError, project_blocks, project_pixels
from tests.fitting.test_project_blocks import BASIS as PAIRS, arrays
from tests.fitting.test_project_pixels import BASIS, LIGHTS, PIXELS, Lazy, photographs
from tests.helpers import DTYPE, X64, assert_close

h5py = pytest.importorskip("h5py", reason="HDF5: pip install h5py")


def test_pixels_from_and_to_a_file_that_is_opened_again(tmp_path):
    shape, path, settings = (PIXELS, BASIS.count, 3), tmp_path / "pixels.h5", {"rows": 20, "every": 0.0}
    values = photographs()
    values[7, 3] = np.nan
    with h5py.File(path, "w") as file:
        file.create_dataset("photographs", data=values, chunks=(20, len(LIGHTS), 3), compression="gzip")
        out = file.create_dataset("coefficients", shape, np.dtype(DTYPE), chunks=(20, *shape[1:]))
        with pytest.raises(OSError, match="the disk is gone"):
            project_pixels(BASIS, LIGHTS, Lazy(values, broken=60), out=out, checkpoint=tmp_path / "kept", **settings)
    with h5py.File(path, "r+") as file:
        source, out, said = file["photographs"], file["coefficients"], []
        before = out[45]
        out[45] = 0
        with pytest.raises(TileError, match="tile 2: was done, and out does not hold its fit"):
            project_pixels(BASIS, LIGHTS, source, out=out, checkpoint=tmp_path / "kept", **settings)
        out[45] = before
        fit = project_pixels(
            BASIS,
            LIGHTS,
            source,
            out=out,
            checkpoint=tmp_path / "kept",
            verify="all",
            on_tile=lambda number, of: said.append(number),
            **settings,
        )
        assert said == [3, 4, 5]
        assert fit.coefficients is out
        assert fit.relit(LIGHTS[0], slice(0, 5)).shape == (5, 3)
    with h5py.File(path) as file:
        whole = project_pixels(BASIS, LIGHTS, values)
        assert_close(file["coefficients"][:], whole.coefficients)
        assert whole.partial == 1


def test_a_dataset_of_other_shape_or_that_cannot_be_written(tmp_path):
    with h5py.File(tmp_path / "pixels.h5", "w") as file:
        file.create_dataset("few", (3, BASIS.count, 3), np.dtype(DTYPE))
        file.create_dataset("whole", (PIXELS, BASIS.count, 3), np.dtype(DTYPE))
        with pytest.raises(ValueError, match=r"got \(3, 9, 3\)"):
            project_pixels(BASIS, LIGHTS, photographs(), out=file["few"])
    with h5py.File(tmp_path / "pixels.h5", "r") as file:
        with pytest.raises(Exception, match=r"(?i)write") as caught:
            project_pixels(BASIS, LIGHTS, photographs(), out=file["whole"])
        assert caught.value.__notes__ == ["while the coefficients of tile 0 were written"]


def test_blocks_of_datasets(tmp_path):
    names = ("wi", "wo", "value", "weight")
    with h5py.File(tmp_path / "samples.h5", "w") as file:
        for name, array in zip(names, arrays(), strict=True):
            file.create_dataset(name, data=array, chunks=True)
    with h5py.File(tmp_path / "samples.h5") as file:
        blocks = SampleBlocks(*(file[name] for name in names), rows=700, isotropic=True)
        got = project_blocks(PAIRS, blocks, checkpoint=tmp_path / "kept")
    expected = project_blocks(PAIRS, SampleBlocks(*arrays(), rows=700, isotropic=True))
    assert_close(got.model.coefficients, expected.model.coefficients, tolerance=None if X64 else 1e-3)


def test_half_floats_and_bytes_of_a_camera(tmp_path):
    raw = (255 * photographs()).astype(np.uint8)
    with h5py.File(tmp_path / "pixels.h5", "w") as file:
        out = file.create_dataset("coefficients", (PIXELS, 4, 3), np.float16)
        source = file.create_dataset("photographs", data=raw)
        project_pixels(HSH(1), LIGHTS, source, out=out, rows=50)
        expected = project_pixels(HSH(1), LIGHTS, raw).coefficients
        np.testing.assert_allclose(out[:], expected, rtol=1e-3, atol=0.2)
