# SPDX-License-Identifier: Apache-2.0
"""Draw what an imported log and its identified plant show, for docs/real_log.md.

    python benchmarks/real_log.py axis-run axis-found

RUN is what `dz bag import` wrote, FOUND what `dz driver identify --from RUN` did. Writes
docs/images/real_log_prediction.png and real_log_characteristic.png.
"""

from __future__ import annotations

from pathlib import Path
import shutil
import sys

import numpy as np

from dz_ros.core.loop.integration import make_advance
from dz_ros.core.loop.offline import simulate
from dz_ros.files.configurations import load_configuration
from dz_ros.recording.reader import read_run
from dz_ros.report.style import axis_label, BLUE, GREY, legend, new_figure, RED, styled

IMAGES = Path(__file__).parents[1] / 'docs' / 'images'


def main(run_path: Path, found: Path) -> None:
    """Write the two pictures."""
    run, c = read_run(run_path), load_configuration(str(found / 'identified.yaml'), [])
    state, v = run.channels['state'], run.channels['command']['v']
    t, x, period = state['stamp'], state['x0'], c.loop.period
    advance = make_advance(c.plant.regressors, c.plant.disturbance)
    place = [float(x[0]), float(np.polyfit(t[:11], x[:11], 2)[1])]
    path, work = [], ([0.0] * c.plant.regressor_count, *([0.0] * 2 for _ in range(4)))
    for k, command in enumerate(v.tolist()):
        path.append(place[0])
        advance(place, command, k * period, period / 4, 4, c.plant.constants,
                c.dead_zone.constants, *work)
    rest = np.array(path) - x
    print(f'explained: {100.0 * (1.0 - np.mean(rest ** 2) / np.var(x)):.2f} %, RMS '
          f'{np.sqrt(np.mean(rest ** 2)):.2g}')
    loop = simulate(c)
    with styled():
        figure = new_figure(9.2, 5.6)
        upper, middle, lower = figure.subplots(3, 1, sharex=True)
        upper.plot(t, x, color=GREY, lw=2.5, label='measured')
        upper.plot(t, path, color=BLUE, label='simulated from the commands alone')
        upper.set_ylabel(axis_label('x', 'm'))
        middle.plot(t, 1e3 * rest, color=BLUE, label='simulated − measured')
        middle.set_ylabel(axis_label('difference', 'mm'))
        lower.plot(loop.t, 1e3 * (loop.x[:, 0] - loop.x_d[:, 0]), color=RED,
                   label='proposed loop on the identified plant')
        lower.plot(t, 1e3 * (x - run.channels['reference']['xd0']), color=GREY,
                   label='the loop that was recorded')
        lower.set_ylabel(axis_label('tracking error', 'mm'))
        lower.set_xlabel(axis_label('time', 's'))
        for ax in (upper, middle, lower):
            legend(ax, 2)
        figure.savefig(IMAGES / 'real_log_prediction.png', dpi=110)
    shutil.copyfile(found / 'characteristic.png', IMAGES / 'real_log_characteristic.png')


if __name__ == '__main__':
    main(Path(sys.argv[1]), Path(sys.argv[2]))
