"""Meshes, read back by the letter of the format."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.io.ply import triangles, write_ply
from hshjax.surface import Surface, height_field
from tests.helpers import DTYPE


def parse(path) -> dict[str, np.ndarray]:
    """Vertices and faces of a binary PLY whose faces are triangles. Source: G. Turk, The PLY Polygon File Format."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    elements: list[tuple[str, int, list[str]]] = []
    for words in map(str.split, lines[2:]):
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            elements[-1][2].append(" ".join(words[1:]))
    types = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4"}
    found, offset = {}, 0
    for name, count, properties in elements:
        if name == "face":
            assert properties == ["list uchar int vertex_indices"]
            dtype = np.dtype([("n", "u1"), ("vertices", "<i4", 3)])
        else:
            dtype = np.dtype([(word.split()[1], types[word.split()[0]]) for word in properties])
        found[name] = np.frombuffer(body, dtype, count, offset)
        offset += count * dtype.itemsize
    assert offset == len(body)
    return found


def heights(rows=5, columns=7):
    y, x = np.mgrid[:rows, :columns] / 4.0
    return jnp.asarray(np.sin(x) * np.cos(2 * y), DTYPE)


def columns(elements, names):
    return np.stack([elements[name] for name in names], -1)


def test_a_whole_rectangle(tmp_path):
    surface = height_field(heights(), spacing=0.5)
    write_ply(tmp_path / "a.ply", surface)
    mesh = parse(tmp_path / "a.ply")
    vertices, normals, faces = columns(mesh["vertex"], "xyz"), columns(mesh["vertex"], ("nx", "ny", "nz")), mesh["face"]
    np.testing.assert_allclose(vertices, np.asarray(surface.position).reshape(-1, 3), atol=1e-6)
    np.testing.assert_allclose(normals, np.asarray(surface.normal).reshape(-1, 3), atol=1e-6)
    assert np.all(faces["n"] == 3)
    assert len(faces) == 2 * 4 * 6
    a, b, c = np.moveaxis(vertices[faces["vertices"]].astype(float), 1, 0)
    normal = np.cross(b - a, c - a)
    assert np.all(normal[:, 2] > 0)  # counter-clockwise as the camera sees them
    # Together they cover the rectangle once.
    assert abs(normal[:, 2].sum() / 2 - 4 * 6 * 0.5**2) < 1e-5
    # Triangles lie along the normals of their corners.
    corner = normals[faces["vertices"]].mean(axis=1)
    cosine = np.sum(normal * corner, -1) / np.linalg.norm(normal, axis=-1) / np.linalg.norm(corner, axis=-1)
    assert cosine.min() > 0.98


MASKS = {
    "a hole": ["11111", "11011", "11111"],
    "a corner cut off": ["011", "111"],
    "two pieces": ["11011", "11011"],
    "a line": ["000", "111", "000"],
    "diagonal": ["10", "01"],
}


@pytest.mark.parametrize("case", MASKS)
def test_triangles_inside_masks(case):
    mask = np.array([[pixel == "1" for pixel in row] for row in MASKS[case]])
    found = triangles(mask)
    pixels = np.argwhere(mask)
    # Brute force: squares of which all or all but one corner is inside.
    expected = 0
    for row in range(mask.shape[0] - 1):
        for column in range(mask.shape[1] - 1):
            inside = mask[row : row + 2, column : column + 2].sum()
            expected += max(0, int(inside) - 2)
    assert len(found) == expected
    a, b, c = np.moveaxis(pixels[found], 1, 0)
    area = ((b - a)[:, 1] * (c - a)[:, 0] - (b - a)[:, 0] * (c - a)[:, 1]) / -2  # rows run down
    assert np.all(area == 0.5)
    assert len({frozenset(triangle) for triangle in found.tolist()}) == len(found)


def test_vertices_are_those_of_the_mask(tmp_path):
    mask = np.ones((5, 7), bool)
    mask[0, 0] = mask[2, 3] = mask[4] = False
    surface = height_field(heights(), mask=mask)
    colours = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    write_ply(tmp_path / "a.ply", surface, colours=colours)
    mesh = parse(tmp_path / "a.ply")
    np.testing.assert_allclose(columns(mesh["vertex"], "xyz"), np.asarray(surface.position)[mask], atol=1e-6)
    assert np.array_equal(columns(mesh["vertex"], ("red", "green", "blue")), colours[mask])
    assert np.array_equal(mesh["face"]["vertices"], triangles(mask))


def test_what_is_no_mesh(tmp_path):
    flat = height_field(jnp.zeros((4, 4), DTYPE))
    for surface, match in (
        (Surface(flat.normal[0], flat.position[0]), r"needs a surface over \(rows, columns\)"),
        (Surface(0 * flat.normal, flat.position), r"got \(4, 4\) and 0"),
        (Surface(flat.normal, jnp.full((4, 4, 3), jnp.nan, DTYPE)), "must be finite"),
    ):
        with pytest.raises(ValueError, match=match):
            write_ply(tmp_path / "a.ply", surface)
    with pytest.raises(ValueError, match=r"colours must be \(4, 4, 3\) of uint8, got \(4, 4, 3\) of float64"):
        write_ply(tmp_path / "a.ply", flat, colours=np.zeros((4, 4, 3)))
    assert not list(tmp_path.iterdir())
