# SPDX-License-Identifier: Apache-2.0
"""The guard under noise: the rule ε >= 4 σ_s, and simulations on both sides of it."""

import pytest

from dz_ros.core.configuration import Configuration
from dz_ros.core.design.finding import INFO, WARNING
from dz_ros.core.design.guard_noise import check_guard, noise_in_s
from dz_ros.core.design.rules import check
from dz_ros.core.loop.offline import simulate
from dz_ros.core.signals import STATUS


def noisy(law, ratio, **changes):
    """Return a configuration whose ε is that many σ_s, noise on the velocity alone."""
    c = Configuration.from_flat({'controller.law': law, 'loop.duration': 15.0, **changes})
    sigma = c.law.design.epsilon / ratio
    return c.replace(**{'plant.noise': [0.0, sigma]})


@pytest.mark.parametrize('law', ['robust', 'robust_eso'])
def test_the_rule_is_what_simulation_shows(law):
    kappas = []
    for ratio, level in ((4.5, INFO), (2.0, WARNING)):
        c = noisy(law, ratio)
        finding, = check_guard(c, 2, 0.0)
        assert finding.level == level
        assert finding.numbers['ratio'] == pytest.approx(ratio)
        place = STATUS + 1 + list(c.law.signal_names).index('kappa_f')
        kappas.append(simulate(c).terms[-1, place])
    assert kappas[0] == 1.0
    assert kappas[1] < 1.0


def test_what_it_does_not_see_is_stated_by_dz_check():
    finding, = (item for item in check(Configuration.from_flat({'controller.law': 'robust_eso'}))
                if item.rule == 'guard')
    assert finding.level == INFO
    assert 'inside the layer it does not see' in finding.words
    assert not [item for item in check(Configuration.from_flat({})) if item.rule == 'guard']


def test_an_observed_velocity_passes_more_noise():
    c = Configuration.from_flat({'controller.law': 'robust_eso', 'plant.noise': [1e-4, 0.0],
                                 'driver.measured': 1})
    assert noise_in_s(c, 1, 0.0) > 10.0 * noise_in_s(c, 2, 0.0)
    finding, = check_guard(c, 1, 6e-3)
    assert finding.level == WARNING
    assert 'widen' in finding.change
