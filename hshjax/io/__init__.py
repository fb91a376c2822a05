"""Files: measured materials, images, models. One file a format."""

from hshjax.io.errors import FileFormatError as FileFormatError
from hshjax.io.exr import exr_channels as exr_channels, read_exr as read_exr, write_exr as write_exr
from hshjax.io.model import load_model as load_model, save_model as save_model
from hshjax.io.rgl import read_rgl as read_rgl
from hshjax.io.tensor_file import read_tensor_file as read_tensor_file
