"""The reflectance equation, Eq. 1 of the paper, and images by it."""

from hshjax.reflectance._monte_carlo import Estimate as Estimate, monte_carlo as monte_carlo
from hshjax.reflectance._picture import Picture as Picture, furnace as furnace, picture as picture
from hshjax.reflectance._reflect import reflect as reflect
from hshjax.reflectance._scene import Scene as Scene, render as render
