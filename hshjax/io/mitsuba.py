"""Saved models as materials of Mitsuba 3. Needs the extra `mitsuba`: `pip install "hshjax[mitsuba]"`.

    import mitsuba as mi
    import hshjax.io.mitsuba

    mi.set_variant("llvm_ad_rgb")           # before or after: whichever variant is chosen, the plugin is there
    hshjax.io.mitsuba.register()
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": material}, ...})

where `material` is `{"type": "hshjax", "filename": "material.hshjax"}`, or in a scene file

    <bsdf type="hshjax"> <string name="filename" value="material.hshjax"/> </bsdf>

Docs: docs/render_elsewhere.md. Mitsuba's interface: its manual, "Custom Python plugins", version 3.9.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax.bases import AbstractPairBasis, AbstractProductBasis
from hshjax.io._formula import Formula, formula, terms
from hshjax.io._proposal import Proposal, fitted_proposal
from hshjax.io.model import load_model

LUMINANCE = (0.212671, 0.715160, 0.072169)
"""Of linear sRGB (ITU-R BT.709), as Mitsuba's `luminance`."""

_registered: list[Callable[..., None]] = []


def register() -> None:
    """Make the BSDF plugin `hshjax` known to Mitsuba, in the variant of now and every one chosen later in this process.

    A material has these parameters:

    - `filename`: of a model that `hshjax.io.save_model` wrote: a `LinearBRDF`, an `ExpBRDF` or a `LogLinearBRDF` over
      `IsotropicBasis`, `HelmholtzBasis` or `TensorBasis` of HSH, Zernike functions or SHR, or over `HalfVectorBasis`.
      Relative to the scene file, as all file names of Mitsuba.
    - `clamp` (default true): negative values, which series of ρ may have, count as 0. Albedos then are a little larger
      than those of the model; how much light is negative stands in what `str` says of the material. With false, they
      are rendered as they are, and pictures are those of `hshjax.reflect`.
    - `sampling`: "lobe" (default) mixes a lobe about the mirror direction, fitted to the model, with the cosine;
      "cosine" takes the cosine alone.

    It reflects on the side of the normal only; wrap it in `twosided` for both. Its parameter `coefficients`
    `(modes x channels)`, first index slowest, can be differentiated and changed (`mi.traverse`); of a `LogLinearBRDF`
    they are those of ln ρ of each channel. Where directions come from (`sampling`) stays as it was fitted at loading.

    Three channels are red, green and blue; in `*_mono` their luminance is rendered. One channel is grey, in every
    variant. Variants `*_spectral` take one channel only: an RGB reflectance is no spectrum. Polarised ones are refused.

    **Raises:** ImportError without Mitsuba. At loading a material: FileFormatError, OSError as `load_model`; ValueError
    for other models, other counts of channels, unknown parameters.
    """
    try:
        mi, _ = _modules()
    except ImportError as error:
        raise ImportError('Mitsuba 3 is missing: pip install "hshjax[mitsuba]"') from error

    if not _registered:

        def changed(_old: str | None = None, _new: str | None = None) -> None:
            mi.register_bsdf("hshjax", _bsdf_class(mi.variant()))

        mi.detail.add_variant_callback(changed)
        _registered.append(changed)  # kept: one callback a process
        if mi.variant() is not None:
            changed()


def _modules() -> tuple[Any, Any]:
    """Mitsuba and Dr.Jit, whose types depend on the variant."""
    import drjit  # pyright: ignore[reportMissingImports]
    import mitsuba

    return mitsuba, drjit


@lru_cache
def _bsdf_class(variant: str) -> type:
    """The plugin on the types of the current variant: a class of Mitsuba exists once for each."""
    mi, dr = _modules()
    jit = not variant.startswith("scalar")

    class SeriesBSDF(mi.BSDF):
        def __init__(self, props: Any):
            super().__init__(props)
            path = str(mi.file_resolver().resolve(props["filename"]))
            self.clamp = bool(props.get("clamp", True))
            sampling = props.get("sampling", "lobe")
            if sampling not in ("lobe", "cosine"):
                raise ValueError(f'sampling must be "lobe" or "cosine", got {sampling!r}')
            model = load_model(path, dtype=jnp.float32)
            self.formula = formula(model)
            _check_channels(self.formula, variant)
            proposal = fitted_proposal(model)
            self.proposal = proposal if sampling == "lobe" else proposal._replace(share=np.zeros_like(proposal.share))
            self.distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, proposal.alpha, True)
            found = self.formula.coefficients
            self.coefficients = mi.Float(found.ravel().astype(np.float32)) if jit else found.tolist()
            self.share = mi.Float(self.proposal.share) if jit else self.proposal.share
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            if not self.formula.basis.isotropic:
                flags = flags | mi.BSDFFlags.Anisotropic
            self.m_components = [flags]
            self.m_flags = flags

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True):
            active = active & (mi.Frame3f.cos_theta(si.wi) > 0) if jit else active and si.wi.z > 0
            bs = dr.zeros(mi.BSDFSample3f) if jit else mi.BSDFSample3f()
            if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection) or (not jit and not active):
                return bs, dr.zeros(mi.Spectrum) if jit else mi.Spectrum(0)
            wi = self._above(si.wi, active)
            by_lobe = sample1 < self._share(wi)
            normal, _ = self.distribution.sample(wi, sample2)
            reflected = 2 * dr.dot(wi, normal) * normal - wi
            reflected.z = dr.abs(reflected.z)
            wo = dr.select(by_lobe, reflected, mi.warp.square_to_cosine_hemisphere(sample2))
            active = active & (wo.z > 0)
            pdf = self._density(wi, self._above(wo, active))
            value = self._foreshortened(ctx, wi, self._above(wo, active)) / pdf
            bs.wo, bs.pdf, bs.eta = wo, dr.select(active, pdf, 0), 1.0
            bs.sampled_component = mi.UInt32(0) if jit else 0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection) if jit else +mi.BSDFFlags.GlossyReflection
            return bs, dr.select(active, value, mi.Spectrum(0))

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True):
            active = self._reflects(ctx, si, wo, active)
            if not jit and not active:
                return mi.Spectrum(0)
            value = self._foreshortened(ctx, self._above(si.wi, active), self._above(wo, active))
            return dr.select(active, value, mi.Spectrum(0))

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True):
            active = self._reflects(ctx, si, wo, active)
            density = self._density(self._above(si.wi, active), self._above(wo, active))
            return dr.select(active, density, 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def traverse(self, callback: Any):
            if jit:
                callback.put("coefficients", self.coefficients, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"hshjax[{_described(self.formula, self.proposal, self.clamp)}]"

        def _reflects(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            return active & ctx.is_enabled(mi.BSDFFlags.GlossyReflection) & (si.wi.z > 0) & (wo.z > 0)

        def _above(self, w: Any, active: Any) -> Any:
            """The pole where nothing is reflected: a masked NaN would still poison derivatives."""
            return dr.select(active, w, mi.Vector3f(0, 0, 1))

        def _share(self, wi: Any) -> Any:
            node = self.proposal.node
            place = (wi.z - float(node[0])) / float(node[1] - node[0])
            if not jit:
                return float(np.interp(wi.z, node, self.share))
            place = dr.clip(place, 0.0, len(node) - 1.0)
            left = dr.minimum(mi.UInt32(place), len(node) - 2)
            a, b = dr.gather(mi.Float, self.share, left), dr.gather(mi.Float, self.share, left + 1)
            return dr.lerp(a, b, place - mi.Float(left))

        def _density(self, wi: Any, wo: Any) -> Any:
            share = self._share(wi)
            lobe = self._lobe(wi, wo) + self._lobe(wi, mi.Vector3f(wo.x, wo.y, -wo.z))
            return share * lobe + (1 - share) * mi.warp.square_to_cosine_hemisphere_pdf(wo)

        def _lobe(self, wi: Any, wo: Any) -> Any:
            total = wi + wo
            normal = total / dr.maximum(dr.norm(total), 1e-20)
            cos = dr.dot(wi, normal)
            density = self.distribution.pdf(wi, normal) / (4 * dr.maximum(cos, 1e-20))
            return dr.select((normal.z > 0) & (cos > 0), density, 0.0)

        def _foreshortened(self, ctx: Any, wi: Any, wo: Any) -> Any:
            """ρ cos θ as Mitsuba has it, at directions above the horizon."""
            # Paths from the eye arrive along wi: the light of the model's wi comes from where they go on.
            light, eye = (wo, wi) if ctx.mode == mi.TransportMode.Radiance else (wi, wo)
            values = _evaluate(self.formula, self._coefficients, light, eye, dr)
            if self.clamp:
                values = [dr.maximum(value, 0.0) for value in values]
            if len(values) > 1 and mi.is_monochromatic:
                values = [sum(weight * value for weight, value in zip(LUMINANCE, values, strict=True))]
            return mi.Spectrum(*values) * wo.z

        def _coefficients(self, t: int) -> Any:
            """Those of a function, one a channel."""
            if not jit:
                return self.coefficients[t]
            kind = mi.Color3f if self.formula.channels == 3 else mi.Color1f
            return dr.gather(kind, self.coefficients, t)

    return SeriesBSDF


def _check_channels(found: Formula, variant: str) -> None:
    """ValueError for what this variant has no colours for."""
    if "polarized" in variant:
        raise ValueError(f"the plugin hshjax knows no polarisation, choose another variant than {variant}")
    allowed = (1,) if "spectral" in variant else (1, 3)
    if found.channels not in allowed:
        expected = "1 channel" if allowed == (1,) else "1 or 3 channels"
        raise ValueError(f"the plugin hshjax takes models of {expected} in {variant}, got {found.channels}")


class _DrJit:
    """Arithmetic on arrays of Dr.Jit, or on numbers in scalar variants."""

    def __init__(self, dr: Any):
        self.sqrt, self.log, self.select = dr.sqrt, dr.log, dr.select

    def keep(self, name: str, value: Any) -> Any:
        return value

    def part(self, title: str) -> None:
        """No comments in compiled programs."""


def _evaluate(found: Formula, coefficients: Callable[[int], Any], light: Any, eye: Any, dr: Any) -> Sequence[Any]:
    """ρ [sr^-1] of every channel; `coefficients(t)` are those of function t."""
    wi, wo = (light.x, light.y, light.z), (eye.x, eye.y, eye.z)
    total: list[Any] = [0.0] * found.channels
    for t, norm, value in terms(found.basis, wi, wo, _DrJit(dr)):
        weighted, row = norm * value, coefficients(t)
        for c in range(found.channels):
            total[c] = total[c] + weighted * row[c]
    if found.low is not None and found.high is not None:
        return [
            dr.exp(dr.minimum(dr.maximum(series, float(low)), float(high)))
            for series, low, high in zip(total, found.low, found.high, strict=True)
        ]
    if found.exponent:
        product = light.z * eye.z
        divisor = product if found.exponent == 1 else dr.sqrt(product)
        return [series / divisor for series in total]
    return total


def _named(basis: AbstractPairBasis) -> str:
    name = type(basis).__name__
    return f"{name}({basis.basis})" if isinstance(basis, AbstractProductBasis) else name


def _described(found: Formula, proposal: Proposal, clamp: bool) -> str:
    kind = "exponential of a series" if found.exponential else "series"
    share = f"{proposal.share.min():.2f} to {proposal.share.max():.2f}"
    lines = [
        f"{kind} in {_named(found.basis)}, {found.basis.count} functions, {found.channels} channels",
        f"smallest value met = {proposal.smallest:.4g} sr^-1, {100 * proposal.negative:.2g} % of its light is negative",
        f"clamp = {'true' if clamp else 'false'}",
        f"lobe of roughness {proposal.alpha:.3g}, share {share}",
    ]
    return "\n  " + ",\n  ".join(lines) + "\n"
