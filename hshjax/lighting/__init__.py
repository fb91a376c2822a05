"""Lights: where radiance comes from, differentiable in every number of theirs."""

from hshjax.lighting._base import (
    AbstractLighting as AbstractLighting,
    Incident as Incident,
    Points as Points,
    SumLighting as SumLighting,
)
from hshjax.lighting._directional import DirectionalLight as DirectionalLight
from hshjax.lighting._environment import EnvironmentMap as EnvironmentMap
from hshjax.lighting._harmonic import HarmonicLight as HarmonicLight
from hshjax.lighting._horizon import Horizon as Horizon, ShadowedLight as ShadowedLight
from hshjax.lighting._point import PointLight as PointLight
from hshjax.lighting._shadow import MaskedLight as MaskedLight
