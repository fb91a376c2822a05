"""Shapes as a camera sees them: normals and positions, pixel by pixel, as `hshjax.reflect` takes them."""

from hshjax.surface._height_field import height_field as height_field
from hshjax.surface._mesh import mesh as mesh
from hshjax.surface._sphere import sphere as sphere
from hshjax.surface._surface import Surface as Surface
