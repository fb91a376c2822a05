"""Files: measured materials, photographs, normals, images, models. One file a format."""

from hshjax.io.alta import measured_alta as measured_alta, read_alta as read_alta
from hshjax.io.astm import measured_astm as measured_astm, read_astm as read_astm
from hshjax.io.coverage import Coverage as Coverage, coverage as coverage
from hshjax.io.csv_samples import (
    measured_csv_samples as measured_csv_samples,
    read_csv_samples as read_csv_samples,
    write_csv_samples as write_csv_samples,
)
from hshjax.io.diligent import read_diligent as read_diligent
from hshjax.io.errors import FileFormatError as FileFormatError
from hshjax.io.exr import exr_channels as exr_channels, read_exr as read_exr, write_exr as write_exr
from hshjax.io.folder import Listed as Listed, list_materials as list_materials
from hshjax.io.fred import measured_fred as measured_fred, read_fred as read_fred
from hshjax.io.glsl import glsl_source as glsl_source, write_glsl as write_glsl
from hshjax.io.image_stack import stack_images as stack_images
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
from hshjax.io.read_material import Material as Material, read_material as read_material
from hshjax.io.read_measured import (
    FORMATS as FORMATS,
    measured_format as measured_format,
    read_measured as read_measured,
    read_samples as read_samples,
)
from hshjax.io.read_mesh import read_mesh as read_mesh
from hshjax.io.rgl import measured_rgl as measured_rgl, read_rgl as read_rgl, write_rgl as write_rgl
from hshjax.io.tensor_file import read_tensor_file as read_tensor_file, write_tensor_file as write_tensor_file
from hshjax.io.utia import measured_utia as measured_utia, read_utia as read_utia
from hshjax.io.zemax import measured_zemax as measured_zemax, read_zemax as read_zemax
