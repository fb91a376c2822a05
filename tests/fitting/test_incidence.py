"""Rules over incidence cover the cone above z_i = low once, whatever the charts; on the host, in float64."""

import numpy as np
import pytest

from hshjax.fitting._incidence import WAYS, incidence_nodes, incident


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("low", [0.0, np.cos(np.radians(80))])
def test_charts_of_a_way_cover_what_is_incident_once(way, low):
    """Solid angle and first moments, from an eye near the normal down to a grazing one."""
    eyes = low + (1 - low) * np.array([0.999999, 0.9, 0.5, 0.1, 0.01, 0.0001])
    total = np.zeros((eyes.size, 4))
    for chart in WAYS[way]:
        wi, wo, weight = incident(chart, eyes, np.full(eyes.size, 0.4), incidence_nodes(chart, 64), low)
        np.testing.assert_allclose(np.linalg.norm(wi, axis=-1), 1, rtol=1e-12)
        np.testing.assert_allclose(wo[:, 2], eyes)
        assert wi[..., 2].min() > low - 1e-12
        total += np.sum(weight[..., None] * np.concatenate([np.ones_like(wi[..., :1]), wi], axis=-1), axis=1)
    # Of the azimuths of lobes an error of fourth order is left, and 3e-5 at the most grazing eye.
    expected = np.array([2 * np.pi * (1 - low), 0, 0, np.pi * (1 - low**2)])
    np.testing.assert_allclose(total, np.broadcast_to(expected, total.shape), atol=1e-4)
