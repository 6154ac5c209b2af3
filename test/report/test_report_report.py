# SPDX-License-Identifier: Apache-2.0
"""The page of a run: everything inside, nothing from outside, nothing half-written.

Over 300 lines: all of it reads pages of the same runs, written once.
"""

from __future__ import annotations

import base64
from contextlib import suppress
from dataclasses import replace
from html.parser import HTMLParser
import re
import warnings

import numpy as np
import pytest

from dz_ros.core.events import (
    ActionEvent,
    ConfigurationEvent,
    FinishedEvent,
    LatencyEvent,
    ModeEvent,
    OtherEvent,
    RepeatEvent,
    StartedEvent,
    UnmeasuredEvent,
)
from dz_ros.errors import ConfigurationError, RecordingError
from dz_ros.report.event_text import event_text
from dz_ros.report.guarantee import guarantee
from dz_ros.report.reference_run import without_dead_zone
from dz_ros.report.report import PICTURES, write_report
from dz_ros.report.view import View

pytestmark = pytest.mark.slow

VOID = {'meta', 'link', 'img', 'br', 'hr', 'input'}


class Page(HTMLParser):
    """What a browser would see: tags that close, every address, every table row, the text."""

    def __init__(self, source):
        super().__init__(convert_charrefs=True)
        self.open, self.addresses, self.images, self.rows, self.ids = [], [], [], [], []
        self.tags, self.words, self.style = [], [], ''
        self.feed(source)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.tags.append(tag)
        if 'id' in values:
            self.ids.append(values['id'])
        self.addresses += [values[key] for key in ('src', 'href', 'srcset', 'data', 'action')
                           if key in values]
        assert not [key for key in values if key.startswith('on')]
        if tag == 'img':
            self.images.append(values)
        if tag == 'tr':
            self.rows.append([])
        if tag in ('td', 'th'):
            self.rows[-1].append('')
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if 'style' in self.open:
            self.style += data
        elif 'td' in self.open or 'th' in self.open:
            self.rows[-1][-1] += data
        self.words.append(data)

    @property
    def text(self):
        return ' '.join(self.words)

    def row(self, first):
        return next(row for row in self.rows if row and row[0] == first)


@pytest.fixture(scope='module')
def report(simulated, over_topics, tmp_path_factory):
    """The paper's run as if recorded, with something nasty in its events."""
    run = replace(over_topics(simulated(), {77: 2_000_000}), events=(
        (1, 'plant_node', 'started'), (5_000_001, 'recorder<node>', '<script>alert(1)</script>')))
    view = View.of(run)
    out = tmp_path_factory.mktemp('report') / 'new' / 'deep'
    path = write_report(run, out, without_dead_zone=without_dead_zone(view), title='A & <B>')
    return view, path, Page(path.read_text(encoding='utf-8'))


def test_nothing_comes_from_outside(report):
    _, _, page = report
    assert page.addresses
    assert all(address.startswith(('data:', '#')) for address in page.addresses)
    assert all(address[1:] in page.ids for address in page.addresses if address.startswith('#'))
    assert not {'script', 'iframe', 'object', 'embed', 'base', 'form'} & set(page.tags)
    assert 'url(' not in page.style
    assert '@import' not in page.style
    assert len(page.ids) == len(set(page.ids))


def test_it_follows_the_reader(report):
    _, path, page = report
    assert 'prefers-color-scheme: dark' in page.style
    assert 'width=device-width' in path.read_text(encoding='utf-8')
    assert {'header', 'nav', 'main', 'section', 'figure', 'figcaption', 'caption',
            'thead'} <= set(page.tags)
    assert page.tags.count('h1') == 1


def test_every_picture_is_there_twice_and_described(report):
    _, path, page = report
    assert [item for item in PICTURES if item in page.ids] == list(PICTURES)
    inside = [base64.b64decode(image['src'].partition('base64,')[2]) for image in page.images]
    files = [(path.parent / f'{name}.png').read_bytes() for name in PICTURES]
    assert sorted(inside) == sorted(files)
    assert all(image['alt'].strip() for image in page.images)
    assert sorted(item.name for item in path.parent.iterdir()) == sorted(
        [path.name, *(f'{name}.png' for name in PICTURES)])


def test_numbers_of_both_runs_with_units_and_words(report):
    view, _, page = report
    row = page.row('max |x̃|')
    assert row[1:3] == [f'{view.metrics.error_max:.4g}', '0.005392']
    assert len(row[3]) > 10
    assert page.row('settled after')[1] == '4.11 s'
    assert page.row('total variation of v')[1].endswith(' 1/s')
    assert 'Window 10 to 20 s, 2001 samples' in page.text


def test_units_are_those_of_the_plant_not_names_of_columns(simulated, tmp_path):
    page = write_report(simulated({'plant.model': 'servo', 'loop.duration': 2.0}), tmp_path / 'r')
    html = page.read_text(encoding='utf-8').partition('Configuration</h')[0]
    text = re.sub(r'<[^>]+>', ' ', html)
    assert re.search(r'max \|x̃\| = \S+ rad', text)
    assert re.search(r'\|x̃\| &lt; \S+ rad', text)
    assert not re.search(r'\d x\d', text)


def test_it_reports_how_both_runs_were_made(report):
    _, _, page = report
    assert 'made in real time over topics' in page.text
    assert 'The run without dead-zone was simulated offline' in page.text
    assert page.row('host') == ['host', 'bench']
    assert page.row('controller.lambda')[1:3] == ['1.0', '1/s']


def test_timing_gaps_and_guarantee_are_reported(report):
    _, _, page = report
    state = [row for row in page.rows if row[0] == 'state']
    assert state[0][1] == 'publish'
    assert state[0][-2:] == ['1', '0']              # one late, none too late
    assert state[1][1:4] == ['4001', '0 … 4000', '0']
    assert page.row('x̃_1')[1] == '0.02'
    assert page.row('x̃_2')[1] == '0.04 1/s'
    assert 'Sampling: the law runs every 5 ms' in page.text


def test_what_comes_from_a_run_is_text_not_markup(report):
    _, path, page = report
    assert '<script>' not in path.read_text(encoding='utf-8')
    assert page.row('0.005') == ['0.005', 'recorder<node>', '<script>alert(1)</script>']
    assert 'A & <B>' in page.words


@pytest.mark.parametrize(('event', 'sentence'), [
    (ConfigurationEvent('/plant_node', {'loop.rate': 200.0}, seq=4, version='0.1.0'),
     'Runs 1 configuration keys from sample 4 on (dz_ros 0.1.0).'),
    (ModeEvent('/c', 'fault', 'active', 'lost', 'no state for 0.1 s'),
     'Changed to mode fault after active: no state for 0.1 s.'),
    (StartedEvent('/c', 0.0), "Started the loop's clock at 0 s."),
    (FinishedEvent('/c', ('state',), 7, {'late': 2}),
     'Finished after sample 7; nothing follows on state; not taken, states and commands: late 2.'),
    (LatencyEvent('/c', 'state to command', 9, 2, 1, 0.0004, max=0.002),
     'Counted 9 delays of state to command: 2 late, 1 too late; median 0.400 ms, largest '
     '2.000 ms.'),
    (ActionEvent('/l', 'set', '127.0.0.1', True, '', 3, '/c', {'controller.lambda': 2.0}),
     '127.0.0.1 asked for set of /c (controller.lambda 2.0): done.'),
    (RepeatEvent('/f', 2, 40), 'Began repeat 2 at sample 40.'),
    (UnmeasuredEvent('/p', ((3, 5), (9, 9)), 'the bus was silent', 4),
     'Had no measurement in 4 samples (3 to 5, 9): the bus was silent.'),
    (OtherEvent('/x', 'later', more={'field': 1}), 'later: field 1'),
], ids=lambda value: getattr(value, 'kind', ''))
def test_events_are_sentences(event, sentence):
    assert event_text(event.to_json()) == sentence


def test_what_is_no_event_is_shown_as_it_is():
    assert event_text('not {json') == 'not {json'
    assert event_text('[1, 2]') == '[1, 2]'
    assert len(event_text('x' * 1000)) == 301


def test_an_offline_run_reports_it_has_no_timing(simulated, tmp_path):
    page = Page(write_report(simulated({'loop.duration': 2.0}), tmp_path).read_text('utf-8'))
    assert 'No timing is judged: this run was computed offline' in page.text
    assert 'periods' not in page.ids
    assert 'error_without' not in page.ids


def test_a_second_run_of_ones_own_is_not_called_simulated(simulated, over_topics, tmp_path):
    run = simulated({'loop.duration': 2.0})
    page = Page(write_report(run, tmp_path, without_dead_zone=over_topics(run)).read_text('utf-8'))
    assert 'without dead-zone is another one, made in real time' in page.text


def test_a_run_of_hardware_reports_what_is_not_known(simulated, over_topics, tmp_path):
    run = over_topics(simulated({'loop.duration': 2.0}))
    bare = replace(run, configuration={}, info={}, channels={
        name: run.channels[name] for name in ('state', 'reference', 'command')})
    page = Page(write_report(bare, tmp_path).read_text('utf-8'))
    assert 'There is no truth in this run' in page.text
    assert 'no terms of the law' in page.text
    assert 'unknown how it was made' in page.text
    assert 'Nothing is known of the law' in page.text
    assert not {'dead_zone', 'estimates', 'parts', 'filtered_error'} & set(page.ids)
    assert not re.search(r'\bnan\b', page.text, re.IGNORECASE)


def test_losses_restarts_and_freezes_are_reported(simulated, over_topics, keep, tmp_path):
    run = over_topics(simulated({'loop.duration': 2.0}))
    run.channels['terms'].values[5:8, run.channels['terms'].labels.index('status')] = 5.0
    run = keep(run, command=np.setdiff1d(np.arange(401), [3, 4]),
               reference=np.setdiff1d(np.arange(401), [9]))
    page = Page(write_report(run, tmp_path).read_text('utf-8'))
    command = [row for row in page.rows if row[0] == 'command'][-1]
    assert command[1:] == ['399', '0 … 400', '2', '0', '0', '0', '2']
    assert "1 reference(s) brought to a state's stamp" in page.text
    assert 'bad interval in 3 sample(s), stale reference in 3 sample(s)' in page.text


def test_a_report_is_replaced_and_what_it_no_longer_has_goes(simulated, tmp_path):
    other_file = tmp_path / 'notes.txt'
    other_file.write_text('mine')
    write_report(simulated({'loop.duration': 2.0}), tmp_path, title='first')
    assert (tmp_path / 'estimates.png').exists()
    path = write_report(simulated({'loop.duration': 2.0, 'controller.law': 'pd'}), tmp_path,
                        title='second')
    assert 'second' in path.read_text('utf-8')
    assert not (tmp_path / 'estimates.png').exists()
    assert other_file.read_text() == 'mine'


@pytest.mark.parametrize('topic', ['state', 'command', 'terms'])
def test_numbers_that_overflow_in_a_picture_give_no_warning(simulated, tmp_path, topic):
    run = simulated({'loop.duration': 2.0})
    channel = run.channels[topic]
    values = channel.values.copy()
    values[3::2, 2:4] = -1e308
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with suppress(RecordingError):      # one line, where there is no axis for them
            write_report(replace(run, channels={
                **run.channels, topic: replace(channel, values=values)}), tmp_path / 'out')


def test_an_error_leaves_nothing_half_written(simulated, keep, tmp_path):
    out = tmp_path / 'out'
    with pytest.raises(RecordingError):
        write_report(keep(simulated(), state=[0]), out)
    with pytest.raises(ConfigurationError):
        write_report(simulated(), out, window=(1.0, 0.0))
    assert not out.exists()
    file = tmp_path / 'file'
    file.write_text('mine')
    with pytest.raises(ConfigurationError, match=r'out = .*must be a directory'):
        write_report(simulated({'loop.duration': 1.0}), file)
    assert file.read_text() == 'mine'


def test_the_reference_run_differs_in_the_dead_zone_alone(simulated):
    view = View.of(simulated({'loop.duration': 2.0, 'plant.dead_zone.m_r': 1.2,
                              'plant.dead_zone.b_l_drift': (0.1, 1.0)}))
    found = without_dead_zone(view)
    changed = {key for key, value in found.configuration.items()
               if value != view.setting.flat[key]}
    assert changed == {'plant.dead_zone.b_r', 'plant.dead_zone.b_l', 'plant.dead_zone.m_r',
                       'plant.dead_zone.b_l_drift'}
    assert np.allclose(found.channels['truth']['w'], found.channels['command']['v'])
    assert without_dead_zone(View.of(found)) is None
    assert without_dead_zone(View.of(replace(found, configuration={}))) is None


@pytest.mark.parametrize(('overrides', 'broken', 'beyond'), [
    ({}, '', 'Sampling'),
    ({'controller.k_star': 1.0}, '(18): k* = 1 does not cover the dead-zone: rho/m_min = 1.029',
     ''),
    ({'plant.dead_zone.b_r': 0.9}, '(A4): violated: b_r in [0.9, 0.9] but stated', ''),
    ({'plant.dead_zone.m_l': 1.1}, '(A2): the slopes differ', ''),
    ({'plant.dead_zone.m_l': 1.000001}, '', 'Sampling'),
    ({'plant.dead_zone.m_r_drift': (0.05, 1.0)}, 'slope of the dead-zone drifts', ''),
    ({'plant.dead_zone.b_r_drift': (0.05, 1.0)}, '', 'b_r or b_l drifts: with a constant slope'),
    ({'loop.delay': 1}, '', 'Loop delay: 1'),
    ({'driver.measured': 1}, '', '1 of 2 states are measured, x1 is observed (tracking, '),
    ({'plant.noise': (1e-3, 1e-2)}, '', 'Measurement noise of standard deviation 0.001, 0.01'),
    ({'plant.command_limit': 10.0}, '', 'clips |v| to 10'),
    ({'plant.dead_zone.b_r': 0.0, 'plant.dead_zone.b_l': 0.0}, '', 'Sampling'),
])
def test_what_is_guaranteed_and_what_is_not(simulated, overrides, broken, beyond):
    found = guarantee(View.of(simulated({'loop.duration': 4.0, **overrides})))
    assert found.bounds == pytest.approx((0.02, 0.04))
    assert broken in ' '.join(found.broken)
    assert bool(found.broken) == bool(broken)
    assert ('promises nothing' in found.statement) == bool(broken)
    assert beyond in ' '.join(found.beyond)


@pytest.mark.parametrize(('changes', 'chatters'), [
    ({'controller.layer_gain': 71.0, 'controller.observer_rate': 60.0, 'plant.b': 1.9,
      'loop.delay': 1}, True),
    ({'plant.b': 1.0}, False), ({'plant.b': 1.0, 'controller.law': 'robust'}, False)])
def test_chatter_inside_the_layer_is_reported(simulated, changes, chatters):
    found = guarantee(View.of(simulated({'controller.law': 'robust_eso', 'loop.duration': 8.0,
                                         **changes})))
    assert ('Chatter inside the layer' in ' '.join(found.beyond)) is chatters


def test_the_disturbance_is_held_against_what_k_star_leaves(simulated):
    # |δ| = 0.5 a3 |x sin 3t|; k* = 2.5 leaves (2.5 − 0.875/0.85) 0.85 = 1.25
    small = guarantee(View.of(simulated({'plant.a3': 0.5})))
    assert 'a disturbance of up to 1.25 1/s²; this run had 0.6' in small.covered
    assert 'more than k* covers' not in small.covered
    assert 'does not model' in small.beyond[-1]
    large = guarantee(View.of(simulated({'plant.a3': 2.0})))
    assert large.covered.endswith('of it, more than k* covers.')
    none = guarantee(View.of(simulated({'plant.a3': 0.0})))
    assert 'disturbance' not in ' '.join(none.beyond)
    assert none.covered.endswith('this run had 0 1/s² of it.')


def test_a_law_without_layer_or_theorem_is_promised_nothing(simulated):
    found = guarantee(View.of(simulated({'controller.law': 'pd', 'loop.duration': 2.0})))
    assert found.bounds is None
    assert 'pd has no boundary layer' in found.statement
    foreign = replace(simulated(), configuration={
        'controller.law': 'theirs', 'controller.lambda': 2.0, 'controller.epsilon': 0.1})
    found = guarantee(View.of(foreign))
    assert found.bounds == pytest.approx((0.05, 0.2))
    assert 'for comparison only' in found.statement
