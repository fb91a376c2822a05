"""Files: measured materials, photographs, normals, images, models. One file a format."""

from hshjax.io.diligent import read_diligent as read_diligent
from hshjax.io.errors import FileFormatError as FileFormatError
from hshjax.io.exr import exr_channels as exr_channels, read_exr as read_exr, write_exr as write_exr
from hshjax.io.light_positions import (
    read_light_positions as read_light_positions,
    read_photograph_folder as read_photograph_folder,
)
from hshjax.io.merl import measured_merl as measured_merl, read_merl as read_merl, write_merl as write_merl
from hshjax.io.model import load_model as load_model, save_model as save_model
from hshjax.io.normals import read_normals as read_normals, write_normals as write_normals
from hshjax.io.photograph_layers import read_photograph_layers as read_photograph_layers
from hshjax.io.photographs import read_photographs as read_photographs
from hshjax.io.photographs_npz import read_photographs_npz as read_photographs_npz
from hshjax.io.ply import write_ply as write_ply
from hshjax.io.rgl import measured_rgl as measured_rgl, read_rgl as read_rgl, write_rgl as write_rgl
from hshjax.io.tensor_file import read_tensor_file as read_tensor_file, write_tensor_file as write_tensor_file
from hshjax.io.utia import measured_utia as measured_utia, read_utia as read_utia
