# SPDX-License-Identifier: Apache-2.0
"""Write the reference part of the documents from the code: keys, verbs, topics, events, signals.

    python tools/make_reference.py FOLDER

`docs/conf.py` runs it for every build of the site, so the pages cannot lag behind the code.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields as members
import inspect
from pathlib import Path
import re
import sys
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import dz_ros  # noqa: E402
from dz_ros.cli.main import parser_of  # noqa: E402
from dz_ros.cli.verbs import GROUPS  # noqa: E402
from dz_ros.core import schema  # noqa: E402
from dz_ros.core.configuration import SECTIONS, SELECTORS  # noqa: E402
from dz_ros.core.deadzone import DeadZone  # noqa: E402
from dz_ros.core.events import KINDS  # noqa: E402
from dz_ros.core.laws import LAWS  # noqa: E402
from dz_ros.core.plants import PLANTS  # noqa: E402
from dz_ros.core.records import Command, Reference, State, Terms, Truth  # noqa: E402
from dz_ros.core.signals import Signal, TERMS  # noqa: E402
from dz_ros.errors import DzRosError  # noqa: E402
from dz_ros.files.configurations import shipped_configurations  # noqa: E402
from dz_ros.recording.channels import CHANNELS  # noqa: E402


def main(folder: Path) -> int:
    """Write every page into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        path = folder / f'{name}.md'
        if not path.is_file() or path.read_text(encoding='utf-8') != text:
            path.write_text(text, encoding='utf-8')
    return 0


def pages() -> dict[str, str]:
    """Return name → Markdown of every page."""
    made = {'keys': keys(), 'verbs': verbs(), 'messages': messages(), 'events': events(),
            'signals': signals(), 'configurations': configurations(), 'api': api()}
    return {name: '\n'.join(lines) + '\n' for name, lines in made.items()}


def keys() -> Iterator[str]:
    """Yield the page of all configuration keys."""
    yield '# Keys of a configuration\n'
    yield ('A configuration is a ROS parameter file; `--set KEY=VALUE` changes a key, '
           '`ros2 param set` one that is not marked *fixed* while a loop runs.\n')
    for section, (settings, registry, group) in SECTIONS.items():
        yield f'\n## {section}\n'
        yield from _group(section, settings)
        if section == 'plant':
            yield '\n### plant.dead_zone\n'
            yield from _group('plant.dead_zone', DeadZone)
        if registry is None:
            continue
        for name, found in registry.all().items():
            if isinstance(found, DzRosError):
                continue
            yield f'\n### {section}.{SELECTORS[section]}: {name}\n'
            yield f'{_escaped(found.summary)}.\n'
            yield from _group(section, getattr(found, group))


def _group(prefix: str, group: Any) -> Iterator[str]:
    """Yield the table of a group of parameters."""
    rows = [(f'`{prefix}.{item.name}`', item.spec.description, _default(item.default),
             item.unit or '–', item.spec.range_text() or 'any', item.kind,
             'yes' if item.spec.structural else '') for item in schema.fields(group)]
    if not rows:
        yield 'No keys of its own.'
        return
    yield from _table(('key', 'meaning', 'default', 'unit', 'allowed', 'type', 'fixed'), rows)


def _default(value: Any) -> str:
    """Return a default as files have it."""
    if isinstance(value, tuple):
        return f'[{", ".join(map(_default, value))}]'
    if isinstance(value, bool):
        return str(value).lower()
    return f'{value:g}' if isinstance(value, float) else str(value) or "''"


def verbs() -> Iterator[str]:
    """Yield the page of all verbs of ``dz``."""
    yield '# Verbs of dz\n'
    for heading, group in GROUPS.items():
        yield f'\n## {heading.capitalize()}\n'
        for path, verb in group.items():
            yield f'\n### dz {" ".join(path)}\n'
            yield f'{_escaped(verb.summary)}.\n'
            yield '```text'
            yield _help(path)
            yield '```'


def _help(path: tuple[str, ...]) -> str:
    """Return the help of a verb, 100 columns wide."""
    parser: Any = parser_of([*path])
    for word in path:
        choices = next(action.choices for action in parser._actions if action.choices
                       and isinstance(action.choices, dict))
        parser = choices[word]
    return str(parser.format_help()).rstrip()


def messages() -> Iterator[str]:
    """Yield the page of topics and the fields of their messages."""
    yield '# Topics and fields\n'
    yield ('Guarantees, rates, who waits for whom, and what is not recorded (`estop`, '
           '`/diagnostics`, `pace`, services `~/estop`, `~/reset`): [Topics](../topics.md).\n')
    yield from _table(('topic', 'type', 'reliability', 'durability', 'carries'), [
        (f'`{item.name}`', item.type.name, item.qos.reliability, item.qos.durability,
         item.description) for item in CHANNELS.values()])
    yield ('\nFields of the arrays, in order, for a plant of order 2; units are expressions as in '
           '[Signals](signals.md). In `terms` the signals of the law follow.\n')
    for topic, items in {'reference': Reference.fields(2), 'state': State.fields(2),
                         'command': Command.fields(), 'terms': Terms.fields(()),
                         'truth': Truth.fields()}.items():
        yield f'\n## {topic}\n'
        yield from _table(('field', 'unit', 'meaning'), [
            (f'`{item.name}`', f'`{item.unit}`' if item.unit else '–', item.meaning)
            for item in items])


def events() -> Iterator[str]:
    """Yield the page of all events."""
    yield '# Events\n'
    yield 'JSON text on the topic `events`; fields that are not known are left out.\n'
    for name, kind in KINDS.items():
        if not name:
            continue
        lines = inspect.cleandoc(kind.__doc__ or '').splitlines()
        yield f'\n## {name}\n'
        yield f'{_escaped(lines[0])}\n'
        described = {name: text for item in reversed(kind.__mro__[:-1])
                     for name, text in _attributes(item.__doc__ or '').items()}
        yield from _table(('field', 'meaning'), [
            (f'`{item.name}`', described.get(item.name, '')) for item in members(kind)
            if item.name != 'more'])


def _attributes(docstring: str) -> dict[str, str]:
    """Return name → meaning of the section Attributes of a docstring."""
    found: dict[str, str] = {}
    text = inspect.cleandoc(docstring).partition('Attributes:\n')[2]
    for match in re.finditer(r'^    ([\w, ]+): (.*(?:\n {8,}.*)*)', text, re.MULTILINE):
        for name in match[1].split(', '):
            found[name.strip()] = ' '.join(match[2].split())
    return found


def signals() -> Iterator[str]:
    """Yield the page of the signals of every law."""
    yield '# Signals\n'
    yield ('Units are expressions: `x^(i)` is the unit of the i-th derivative of the output, `v` '
           'that of the command, `Y1` … those of the regressors.\n')
    yield '## Every law\n'
    yield from _signals(TERMS)
    plant = PLANTS.load('wang2004')
    for name, law in LAWS.all().items():
        if isinstance(law, DzRosError):
            continue
        own = _own_signals(law, plant)
        yield f'\n## {name}\n'
        yield f'{_escaped(law.summary)}.\n'
        if own:
            yield from _signals(own)
        else:
            yield 'No signals of its own.'


def _own_signals(law: Any, plant: Any) -> tuple[Signal, ...]:
    """Return the signals of a law's own for the plant of the paper."""
    from dz_ros.core.configuration import Configuration

    made = Configuration.from_flat({'controller.law': law.name, 'plant.model': plant.name}).law
    return tuple(made.signals)


def _signals(items: Iterable[Signal]) -> Iterator[str]:
    yield from _table(('signal', 'symbol', 'unit', 'role', 'meaning'),
                      [(f'`{item.name}`', item.symbol, f'`{item.unit}`' if item.unit else '–',
                        item.role.value, item.meaning) for item in items])


def configurations() -> Iterator[str]:
    """Yield the page of the shipped configurations."""
    yield '# Shipped configurations\n'
    for name, path in shipped_configurations().items():
        yield f'\n## {name}\n'
        yield '```yaml'
        yield path.read_text(encoding='utf-8').rstrip()
        yield '```'


def api() -> Iterator[str]:
    """Yield the page of the Python API."""
    yield '# Python API\n'
    yield 'How it is used: [From Python](../python.md).\n'
    for name in dz_ros.__all__:
        item = getattr(dz_ros, name)
        kind = 'class' if inspect.isclass(item) else 'function'
        yield f'\n## {name}\n'
        yield '```{eval-rst}'
        yield f'.. auto{kind}:: dz_ros.{name}'
        if kind == 'class':
            yield '   :members:'
        yield '```'


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield a Markdown table."""
    head = list(head)
    yield f'| {" | ".join(head)} |'
    yield f'|{"---|" * len(head)}'
    for row in rows:
        yield f'| {" | ".join(map(_escaped, row))} |'


def _escaped(text: str) -> str:
    """Return a text as a cell of a table or a paragraph."""
    if text.startswith('`') and text.endswith('`'):
        return text
    if '`' in text:
        return text.replace('|', '\\|')
    return re.sub(r'(?<!\\)([|<*_])', r'\\\1', text)


if __name__ == '__main__':
    sys.exit(main(Path(sys.argv[1])))
