"""Compact, reciprocal reflectance in JAX.

Bases of the hemisphere and of pairs of directions, BRDFs that are linear in them, analytic and measured BRDFs, fits in
closed form or by gradients, and the reflectance equation under distant and nearby light. Files live in `hshjax.io`;
pictures, which need the extra `experiments`, in `hshjax.plotting`.
"""

from hshjax.bases import (
    HSH as HSH,
    SHR as SHR,
    AbstractBasis as AbstractBasis,
    AbstractPairBasis as AbstractPairBasis,
    AbstractProductBasis as AbstractProductBasis,
    AbstractWarp as AbstractWarp,
    AnisotropicHalfVectorBasis as AnisotropicHalfVectorBasis,
    HalfVectorBasis as HalfVectorBasis,
    HelmholtzBasis as HelmholtzBasis,
    IdentityWarp as IdentityWarp,
    IsotropicBasis as IsotropicBasis,
    LogWarp as LogWarp,
    LowRank as LowRank,
    RationalWarp as RationalWarp,
    RootWarp as RootWarp,
    SphericalHarmonics as SphericalHarmonics,
    TensorBasis as TensorBasis,
    Zernike as Zernike,
    anisotropic_order as anisotropic_order,
    convert as convert,
    factorize as factorize,
    from_matrix as from_matrix,
    from_ordered as from_ordered,
    to_matrix as to_matrix,
    to_ordered as to_ordered,
    total_order as total_order,
)
from hshjax.brdfs import (
    ABC as ABC,
    GGX as GGX,
    AbstractBRDF as AbstractBRDF,
    AbstractFresnel as AbstractFresnel,
    BlinnPhong as BlinnPhong,
    ConductorFresnel as ConductorFresnel,
    ConstantFresnel as ConstantFresnel,
    CookTorrance as CookTorrance,
    DielectricFresnel as DielectricFresnel,
    ExpBRDF as ExpBRDF,
    Lambert as Lambert,
    LinearBRDF as LinearBRDF,
    LogLinearBRDF as LogLinearBRDF,
    OrenNayar as OrenNayar,
    SchlickFresnel as SchlickFresnel,
    SoftplusBRDF as SoftplusBRDF,
    SquaredBRDF as SquaredBRDF,
    TabulatedBRDF as TabulatedBRDF,
    Ward as Ward,
    bounded as bounded,
)
from hshjax.camera import OrthographicCamera as OrthographicCamera, PerspectiveCamera as PerspectiveCamera
from hshjax.fitting import (
    NORMS as NORMS,
    AbstractTerm as AbstractTerm,
    Cauchy as Cauchy,
    Certificate as Certificate,
    CompactFit as CompactFit,
    CosineWeighted as CosineWeighted,
    CubeRoot as CubeRoot,
    EnergyConservation as EnergyConservation,
    Fit as Fit,
    GemanMcClure as GemanMcClure,
    Huber as Huber,
    Identity as Identity,
    IsotropicTable as IsotropicTable,
    IterativeFit as IterativeFit,
    Jaxopt as Jaxopt,
    LevenbergMarquardt as LevenbergMarquardt,
    LogCosineWeighted as LogCosineWeighted,
    LogRelative as LogRelative,
    MultiStart as MultiStart,
    NonNegativity as NonNegativity,
    Norm as Norm,
    Of as Of,
    Outcome as Outcome,
    Prior as Prior,
    Reciprocity as Reciprocity,
    SampleMisfit as SampleMisfit,
    Smoothness as Smoothness,
    Sparsity as Sparsity,
    fit as fit,
    fit_compact as fit_compact,
    fit_compact_all as fit_compact_all,
    half_vector_samples as half_vector_samples,
    initial_guesses as initial_guesses,
    largest_sparsity_weight as largest_sparsity_weight,
    misfit as misfit,
    multi_start as multi_start,
    order_sweep as order_sweep,
    positive_start as positive_start,
    project as project,
    project_all as project_all,
    relative_error as relative_error,
    sparsity_path as sparsity_path,
)
from hshjax.geometry import angles as angles, direction as direction, half_vector as half_vector
from hshjax.lighting import (
    AbstractLighting as AbstractLighting,
    DirectionalLight as DirectionalLight,
    EnvironmentMap as EnvironmentMap,
    HarmonicLight as HarmonicLight,
    Horizon as Horizon,
    MaskedLight as MaskedLight,
    PointLight as PointLight,
    ShadowedLight as ShadowedLight,
)
from hshjax.metrics import (
    Negativity as Negativity,
    ReciprocityError as ReciprocityError,
    albedo as albedo,
    hemispherical_albedo as hemispherical_albedo,
    negativity as negativity,
    reciprocity_error as reciprocity_error,
)
from hshjax.quadrature import (
    PairRule as PairRule,
    Rule as Rule,
    hemisphere_rule as hemisphere_rule,
    isotropic_pair_rule as isotropic_pair_rule,
    pair_rule as pair_rule,
)
from hshjax.reflectance import Scene as Scene, monte_carlo as monte_carlo, reflect as reflect, render as render
from hshjax.samples import Samples as Samples
from hshjax.surface import Surface as Surface, height_field as height_field, mesh as mesh, sphere as sphere

__version__ = "0.1.0"
