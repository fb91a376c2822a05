"""Shape from photographs under many lights."""

from hshjax.stereo._height import depth_from_normals as depth_from_normals, height_from_normals as height_from_normals
