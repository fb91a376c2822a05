"""The worker of sphericart-jax and zernipax: runs inside their environment, and knows nothing of this project.

    python _harmonics.py CORES

A case is that of `_matrix`: what is timed is what the peer offers for it.

- `evaluate`, `rows` of HSH: spherical harmonics of the same order, written out, in spherical coordinates of the sphere
  (a hemisphere's harmonics are these at stretched directions; the stretch is not asked of the peer).
- `by coefficients`, `by directions`: the gradient of a sum over them, through the product with the coefficients.
- `rows`, `evaluate` of Zernike: radial polynomials times the Fourier series, each computed once per (n, |m|) and m.
"""

import sys
import time

from _serve import Prepared, claim, clock, cores_of, serve

CORES = cores_of(sys.argv[1])
claim(CORES)

import jax  # noqa: E402  after the cores have been claimed, which it counts
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402


def spherical(case, w, coefficients, weight):
    import sphericart.jax

    order = case["order"]

    def rows(w):
        return sphericart.jax.spherical_harmonics(w, order)

    def weighted(coefficients, w):
        return jnp.sum(weight * (rows(w) @ coefficients))

    match case["verb"]:
        case "evaluate" | "rows":
            return rows, (w,)
        case "by coefficients":
            return jax.grad(weighted), (coefficients, w)
        case "by directions":
            return jax.grad(weighted, argnums=1), (coefficients, w)
    raise ValueError(f"sphericart-jax has nothing to compare with {case}")


def zernike(case, w):
    from zernipax.zernike import fourier, zernike_radial_cpu

    modes = np.array([(n, m) for n in range(case["order"] + 1) for m in range(-n, n + 1, 2)])
    radial, radial_at = np.unique(np.stack([modes[:, 0], abs(modes[:, 1])]), axis=1, return_inverse=True)
    m, m_at = np.unique(modes[:, 1], return_inverse=True)
    w = np.asarray(w, np.float64)
    r = jnp.asarray(np.sqrt(1 - w[:, 2]), case["dtype"])
    phi = jnp.asarray(np.arctan2(w[:, 1], w[:, 0]), case["dtype"])

    def rows(r, phi):
        return zernike_radial_cpu(r, radial[0], radial[1], 0)[:, radial_at.ravel()] * fourier(phi[:, None], m)[:, m_at]

    return rows, (r, phi)


def prepare(case):
    jax.config.update("jax_enable_x64", case["dtype"] == "float64")
    jax.block_until_ready(jax.jit(lambda x: x + 1)(jnp.zeros(3)))  # what the first program alone pays for
    rng = np.random.default_rng(0)
    z, phi = rng.uniform(0.02, 1, case["points"]), rng.uniform(0, 2 * np.pi, case["points"])
    rim = np.sqrt(1 - z * z)
    w = jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1), case["dtype"])
    if case["basis"] == "Zernike":
        function, arguments = zernike(case, w)
    else:
        shape = (case["order"] + 1) ** 2, case["channels"]
        coefficients = jnp.asarray(rng.normal(size=shape), case["dtype"])
        weight = jnp.asarray(rng.normal(size=(case["points"], case["channels"])), case["dtype"])
        function, arguments = spherical(case, w, coefficients, weight)
    begin = time.process_time()
    compiled = jax.jit(function).lower(*arguments).compile()
    compile_time = time.process_time() - begin
    return Prepared(lambda: jax.block_until_ready(compiled(*arguments)), {"compile": compile_time}, dict)


if __name__ == "__main__":
    serve(prepare, clock(CORES))
