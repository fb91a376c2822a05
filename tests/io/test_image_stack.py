"""Stacks of images in one file."""

import numpy as np
import pytest

from hshjax.io import FileFormatError, stack_images, write_exr
from hshjax.io._images import write_png


def test_a_stack_holds_every_image(tmp_path):
    images = np.random.default_rng(0).integers(0, 2**16, (3, 4, 5, 3), np.uint16)
    paths = [tmp_path / f"{k}.png" for k in range(3)]
    for path, image in zip(paths, images, strict=True):
        write_png(path, image)
    stack = stack_images(paths, tmp_path / "stack.npy")
    assert (stack.shape, stack.dtype) == ((20, 3, 3), np.uint16)
    np.testing.assert_array_equal(stack, images.reshape(3, 20, 3).transpose(1, 0, 2))
    np.testing.assert_array_equal(np.load(tmp_path / "stack.npy", mmap_mode="r").transpose(1, 0, 2), stack)


def test_images_that_do_not_belong_together(tmp_path):
    write_exr(tmp_path / "0.exr", np.ones((4, 5, 3), np.float32))
    write_exr(tmp_path / "1.exr", np.ones((4, 6, 3), np.float32))
    with pytest.raises(FileFormatError, match=r"1.exr.*\(4, 5, 3\) of float32, as of 0.exr"):
        stack_images([tmp_path / "0.exr", tmp_path / "1.exr"], tmp_path / "stack.npy")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["0.exr", "1.exr"]
    with pytest.raises(ValueError, match="at least one image"):
        stack_images([], tmp_path / "stack.npy")
