# SPDX-License-Identifier: Apache-2.0
"""The gain that is named where a loop has no certificate: it has one, or none is named."""

import math

import pytest

from dz_ros.core.design.certificate import certify, DelayBounds
from dz_ros.core.design.certified_gain import gain_keys, SHARES, which_gain
from dz_ros.files.configurations import load_configuration

pytest.importorskip('flint')

SLOW = pytest.mark.slow
"""Computes certificates, in intervals, for a minute."""
PERIOD = 'loop.duration=6.4'
"""One period of the example's reference."""


def named(change):
    """Return the keys and values that a text of what to change begins with."""
    gains = dict(part.split(' = ') for part in change.partition(':')[0].split(' with '))
    return {key: float(value) for key, value in gains.items()}


@SLOW
@pytest.mark.parametrize(('name', 'overrides', 'fails', 'smaller'), [
    ('robust_eso', [PERIOD, 'controller.layer_gain=300'], 'spectral radius', True),
    ('zhang_feng1997', [PERIOD], 'a tube', True)])
def test_gain_named_for_a_loop_without_a_bound_is_certified(name, overrides, fails, smaller):
    configuration = load_configuration(name, overrides)
    found = certify(configuration, (1,))
    assert not found.certified
    assert found.error_bound == ()
    assert fails in found.delays[0].failed[0]
    tried = configuration.replace(**named(found.delays[0].change))
    assert (tried.law.design.gain < configuration.law.design.gain) is smaller
    shown = certify(tried, (1,))
    assert shown.certified
    assert f'certified so at delay 1, |x̃1| <= {shown.error_bound[0]:.3g}' in (
        found.delays[0].change)


def bounds(certified, s_bound=math.inf, epsilon=0.1):
    return DelayBounds(1, certified, (), (), s_bound, epsilon, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(('name', 'key'), [
    ('robust_eso', 'controller.layer_gain'), ('robust', 'controller.margin'),
    ('wang2004', 'controller.epsilon')])
def test_gain_is_named_if_it_is_certified_in_full_only(name, key):
    c = load_configuration(name)
    asked = []

    def up_to(limit):
        def bounds_of(tried, full):
            asked.append((tried.law.design.gain, full))
            return bounds(not full or tried.law.design.gain < limit)
        return bounds_of

    text = which_gain(c, 0, up_to(0.7 * c.law.design.gain))
    tried = c.replace(**named(text))
    assert list(named(text)) == [key]
    assert tried.law.design.gain < 0.7 * c.law.design.gain
    assert f'K = {tried.law.design.gain:.3g}'[:6] in text
    assert asked[-1] == (tried.law.design.gain, True)
    none = which_gain(c, 0, up_to(0.0))
    assert 'none of 9 values of K from' in none
    assert ' = ' not in none


@pytest.mark.parametrize('cap', [40.0, 200.0])
def test_margin_named_gives_the_k_that_is_stated(cap):
    """Where `gain_cap` is what limits K, the configured margin states nothing about it."""
    c = load_configuration('robust', [f'controller.gain_cap={cap}', 'controller.margin=0.8'])
    binding = c.law.design.gain == cap
    assert binding is (cap == 40.0)
    design = c.law.design

    def bounds_of(tried, _):
        return bounds(tried.law.design.gain < 0.7 * design.gain, epsilon=tried.law.design.epsilon)

    text = which_gain(c, 0, bounds_of)
    tried = c.replace(**named(text))
    assert list(named(text)) == ['controller.margin']
    stated = float(text.partition('K = ')[2].partition(' ')[0])
    assert tried.law.design.gain == pytest.approx(stated, rel=1e-3)
    assert 'certified so at delay 0' in text


@pytest.mark.parametrize('gain', [25.0, 60.0])
def test_keys_of_a_gain_beside_a_cap(gain):
    c = load_configuration('robust', ['controller.gain_cap=40', 'controller.margin=0.8'])
    assert c.replace(**gain_keys(c, gain)).law.design.gain == pytest.approx(gain)


def test_layer_is_widened_at_the_same_gain_where_s_leaves_it():
    c = load_configuration('wang2004')

    def bounds_of(tried, _):
        design = tried.law.design
        return bounds(design.epsilon >= 0.2, 0.2, design.epsilon)

    values = named(which_gain(c, 0, bounds_of))
    assert sorted(values) == ['controller.epsilon', 'controller.k_star']
    tried = c.replace(**values)
    assert tried.law.design.epsilon == pytest.approx(0.204)
    assert tried.law.design.gain == pytest.approx(SHARES[0] * c.law.design.gain, rel=1e-3)
