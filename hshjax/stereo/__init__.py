"""Shape, reflectance and lights from photographs under many lights."""

from hshjax.stereo._calibrated import solve_calibrated as solve_calibrated
from hshjax.stereo._height import depth_from_normals as depth_from_normals, height_from_normals as height_from_normals
from hshjax.stereo._history import Stage as Stage
from hshjax.stereo._lambertian import Lambertian as Lambertian, lambertian as lambertian
from hshjax.stereo._natural import NaturalShape as NaturalShape, solve_natural as solve_natural
from hshjax.stereo._natural_light import NaturalLight as NaturalLight, light_from_shape as light_from_shape
from hshjax.stereo._predict import predict as predict
from hshjax.stereo._refine_jointly import refine_jointly as refine_jointly
from hshjax.stereo._result import Stereo as Stereo, angular_errors as angular_errors
from hshjax.stereo._semi_calibrated import solve_semi_calibrated as solve_semi_calibrated
from hshjax.stereo._single_image import SingleImage as SingleImage, solve_single_image as solve_single_image
from hshjax.stereo._uncalibrated import solve_uncalibrated as solve_uncalibrated
