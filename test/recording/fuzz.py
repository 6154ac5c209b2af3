# SPDX-License-Identifier: Apache-2.0
"""A fuzzer of what comes from files: recordings, metadata.yaml, parameter files.

    python test/recording/fuzz.py [--seconds S | --inputs N] [--seed SEED] [--save FOLDER]

Every input follows from its seed alone: a base (a run of ours, or bags of rosbag2's other storages
and compressions) and some mutations of its bytes. Each is read by the verbs info, report, audit,
recover, by the page, and as arrays. What must hold:

    exit code 0, 1 or 2, one line of error at most with 2, no traceback
    memory grows by less than `MEMORY`, CPU time under `HANG`
    what is read are rows, events and configuration of the original, or the reading notes that it
    is cut off or damaged

Files without checksums, and chunks that were altered before theirs was made, are themselves what
they hold: what is read of them are the rows that another reader (mcap's or SQLite's own, rosbags
for the messages) finds there, all of them where nothing is reported. An input that breaks one of
these is kept in FOLDER and its seed printed.

Over 300 lines: making inputs, altering them and judging what is read follow from one seed.
"""

from __future__ import annotations

import argparse
import asyncio
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout
from functools import cache
import io
import json
from pathlib import Path
import random
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import time
import traceback
from typing import Any
import zlib

import numpy as np

from dz_ros.cli.main import main as dz
from dz_ros.core.configuration import Configuration
from dz_ros.core.dataset import from_run, RunData
from dz_ros.core.loop.offline import simulate
from dz_ros.errors import DzRosError
from dz_ros.files.configurations import load_configuration
from dz_ros.live.recorded_source import Recorded
from dz_ros.live.requests import text_of
from dz_ros.recording.reader import read_run
from dz_ros.recording.save import save_run, state_configuration

MEMORY = 1024
"""Most memory that the process takes for one input, beside what it had before [MiB]."""
HANG = 60.0
"""Most CPU time of one input [s]; one takes about half a second."""
START = 1_700_000_000_000_000_000
VERBS = {'info': ['bag', 'info'], 'report': ['report', '--json'], 'audit': ['bag', 'audit'],
         'recover': ['bag', 'recover']}
WORDS = (b'\x00', b'\xff', b'\xff' * 4, b'\xff' * 8, b'\x7f' + b'\xff' * 7, bytes(8),
         b'\x89MCAP0\r\n', b'\x28\xb5\x2f\xfd', b'SQLite format 3\x00', b'nan', b'1e308', b'-1',
         b'&a [*a]', b'*a', b'[' * 2000, b'{' * 2000, b'\x00\x01\x00\x00', b'9' * 400, b'~', b'""')
"""Bytes that readers stumble over."""
CHECKSUMMED = ('ours', 'bare')
"""Bases in which every altered byte shows."""
REPORTED_KEYS = {'cut', 'recovered', 'notes'}
"""What a reading reports of a run that is not as it should be."""
Rows = dict[str, 'Counter[tuple[tuple[str, ...], bytes]]']
"""Channel → (labels, numbers as bytes) → number of messages."""


class HangError(BaseException):
    """An input that takes longer than `HANG`; nothing on the way may handle it."""


class Bases:
    """The originals, made once.

    Attributes:
        folders: Name → folder of a bag, or a parameter file.
        data: What every bag holds.
    """

    def __init__(self, folder: Path) -> None:
        configuration = Configuration.from_flat({'loop.duration': 0.6})
        data = from_run(simulate(configuration), START)
        self.data = state_configuration(RunData(
            data.channels, data.configuration, data.info,
            ((START + 5, '/controller_node', '{"event": "mode", "node": "/controller_node"}'),)),
            configuration.law.initial_memory())
        self.folders = {'ours': save_run(self.data, folder / 'ours').directory}
        bare = folder / 'bare'
        bare.mkdir()
        shutil.copy(self.folders['ours'] / 'ours_0.mcap', bare)
        self.folders['bare'] = bare
        for storage, mode in (('sqlite3', ''), ('sqlite3', 'message'), ('sqlite3', 'file'),
                              ('mcap', 'message'), ('mcap', 'file')):
            name = f'{storage}{mode}'
            if bag(self.folders['ours'], folder / name, storage, mode):
                self.folders[name] = folder / name
        parameters = folder / 'parameters'
        parameters.mkdir()
        (parameters / 'loop.yaml').write_text(
            '/**:\n  ros__parameters:\n    loop: {rate: 200.0, duration: 0.2}\n'
            '    plant:\n      x0: [0.5, 0.0]\n      dead_zone: {b_r: 0.5, b_l: -0.6}\n'
            '    controller:\n      law: wang2004\n      lambda: 2.0\n')
        self.folders['parameters'] = parameters


def bag(run: Path, target: Path, storage: str, mode: str = '', version: int = 9) -> bool:
    """Write a run as rosbag2 would; return False where rosbags is not installed."""
    try:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import get_typestore, Stores
    except ImportError:
        return False
    from dz_ros.recording.run_source import open_source

    store = get_typestore(Stores.ROS2_JAZZY)
    source = open_source(run)
    writer = Writer(target, version=version, storage_plugin=StoragePlugin[storage.upper()])
    if mode:
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        made = {}
        for batch in source.batches():
            for message in batch:
                if message.topic not in made:
                    made[message.topic] = writer.add_connection(
                        message.topic, source.topics[message.topic].type_name, typestore=store)
                writer.write(made[message.topic], message.log_time, message.payload)
    return True


def mutated(data: bytes, chance: random.Random, keep: bool = False) -> bytes:
    """Return the bytes with one to four things done to them."""
    found = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        kind = chance.randrange(8)
        at = chance.randrange(len(found) + 1)
        size = min(chance.choice((1, 2, 8, 100, 5000)), len(found) - at)
        if kind == 0 and size:
            found[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            del found[at:]
        elif kind == 2:
            del found[at:at + size]
        elif kind == 3:
            found[at:at] = found[at:at + size]
        elif kind == 4:
            found[at:at + size] = bytes(size)
        elif kind == 5:
            word = chance.choice(WORDS)
            found[at:at + len(word)] = word
        elif kind == 6:
            found[at:at] = chance.choice(WORDS)
        elif size:
            to = chance.randrange(len(found) + 1)
            found[to:to + size] = found[at:at + size]
    return bytes(found)


def resealed(data: bytes, chance: random.Random) -> bytes:
    """Return an MCAP file whose records are altered and whose checksums fit, as a writer's would.

    The chunks are written plain, so that what is altered is what they hold.
    """
    import zstandard

    magic, position, records = data[:8], 8, []
    while position + 9 <= len(data) - 8:
        length = int.from_bytes(data[position + 1:position + 9], 'little')
        records.append((data[position], data[position + 9:position + 9 + length]))
        position += 9 + length
    found = []
    victim = chance.randrange(len(records))
    for place, (opcode, body) in enumerate(records):
        changed = body
        if opcode == 6:
            begin = body[:16]
            plain = zstandard.ZstdDecompressor().decompress(body[36 + 8:])
            if place == victim:
                plain = mutated(plain, chance)
            changed = (begin + len(plain).to_bytes(8, 'little')
                       + zlib.crc32(plain).to_bytes(4, 'little') + bytes(4)
                       + len(plain).to_bytes(8, 'little') + plain)
        elif opcode == 15:
            changed = bytes(4)
        elif opcode == 2:
            changed = bytes(20)
        elif place == victim and opcode in (3, 4, 12):
            changed = mutated(body, chance)
        elif opcode not in (1, 3, 4, 12):
            continue
        found.append(bytes([opcode]) + len(changed).to_bytes(8, 'little') + changed)
    return magic + b''.join(found) + magic


def make(seed: int, bases: Bases, target: Path) -> tuple[str, bool]:
    """Make the input of a seed; return its base, whether its numbers must be the original's."""
    chance = random.Random(seed)
    name = chance.choice(list(bases.folders))
    shutil.copytree(bases.folders[name], target)
    files = sorted(target.iterdir())
    file = chance.choice(files)
    data = file.read_bytes()
    if name in CHECKSUMMED and file.suffix == '.mcap' and chance.random() < 0.4:
        file.write_bytes(resealed(data, chance))
        return name, False
    file.write_bytes(mutated(data, chance))
    if name != 'ours' and chance.random() < 0.1:
        chance.choice(files).unlink()
    return name, name in CHECKSUMMED


def check(seed: int, bases: Bases, folder: Path) -> str:
    """Return what is wrong with how the input of a seed is treated; '' = nothing."""
    target = folder / f'seed-{seed}'
    name, exact = make(seed, bases, target)
    before = start_of_growth()
    try:
        with limited(HANG):
            found = check_parameters(target) if name == 'parameters' else check_run(
                target, folder / f'copy-{seed}', bases.data, exact)
    except HangError:
        where = ''.join(traceback.format_exc().splitlines(True)[-6:-1])
        return f'more than {HANG:g} s of CPU time in\n{where}'
    used = growth(before)
    return f'{used} MiB used' if used > MEMORY else found


def check_parameters(folder: Path) -> str:
    """Return what is wrong with how a parameter file is read, as one of several loops as well."""
    for namespace in ('', 'left'):
        try:
            load_configuration(folder / 'loop.yaml', namespace=namespace)
        except DzRosError as error:
            if wrong := one_line(str(error)):
                return wrong
        except Exception:  # noqa: BLE001
            return traceback.format_exc()
    return ''


def check_run(target: Path, copy: Path, data: RunData, exact: bool) -> str:
    """Return what is wrong with how a run is treated."""
    for verb, words in VERBS.items():
        extra = [str(copy)] if verb == 'recover' else []
        out, err = io.StringIO(), io.StringIO()
        try:
            with redirect_stdout(out), redirect_stderr(err):
                code = dz([*words, str(target), *extra])
        except Exception:  # noqa: BLE001
            return f'{verb}: {traceback.format_exc()}'
        if code not in (0, 1, 2):
            return f'{verb}: exit code {code}'
        if code == 2 and (wrong := one_line(err.getvalue().strip())):
            return f'{verb}: {wrong}'
    if wrong := check_page(target):
        return wrong
    if exact:
        return same_rows(target, data) or same_rows(copy, data)
    return stored_rows(target, copy, data)


def check_page(path: Path) -> str:
    """Return what is wrong with how the page shows a run."""
    try:
        page = Recorded({'run': read_run(path)})
        json.loads(text_of([page.hello(), page.now()]))
        for request in ({'from': 0.1, 'to': 0.4}, {'do': 'histogram'}, {'skip': 3}):
            answer = asyncio.run(page.ask({'id': 1, 'run': 0, **request}))
            if isinstance(answer, dict):
                json.loads(text_of(answer))
    except DzRosError as error:
        return one_line(str(error))
    except Exception:  # noqa: BLE001
        return f'page: {traceback.format_exc()}'
    return ''


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise HangError where what is done takes more CPU time."""
    def end(*_: object) -> None:
        raise HangError

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def start_of_growth() -> int:
    """Reset the peak of this process's memory; return what `growth` subtracts [KiB].

    That is the memory in use, or the peak so far where Linux does not let a process reset it.
    """
    try:
        Path('/proc/self/clear_refs').write_text('5')
    except OSError:
        return memory('VmHWM')
    return memory('VmRSS')


def growth(start: int) -> int:
    """Return by how much the peak is above the start [MiB]."""
    return (memory('VmHWM') - start) // 1024


def memory(field: str) -> int:
    """Return a field of /proc/self/status [KiB]."""
    return int(Path('/proc/self/status').read_text().partition(f'{field}:')[2].split()[0])


def one_line(text: str) -> str:
    """Return what is wrong with a message; '' = nothing."""
    good = text and '\n' not in text and 'report issue' not in text and len(text) < 3000
    return '' if good else f'reported {text[:3000]!r}'


def same_rows(path: Path, data: RunData) -> str:
    """Return where rows, events or configuration differ from the original's; '' = nowhere.

    A run that is refused differs nowhere.
    """
    try:
        found = read_run(path)
    except DzRosError:
        return ''
    reported = {'cut', 'recovered'} & found.info.keys()
    for name, channel in found.channels.items():
        original = data.channels[name]
        rows = channel['seq'].astype(np.int64)
        if channel.labels != original.labels or (rows >= len(original)).any() or (
                np.diff(rows) <= 0).any():
            return f'{path.name}: {name} has other rows'
        for part in ('values', 'log_time', 'publish_time'):
            if getattr(channel, part).tobytes() != getattr(original, part)[rows].tobytes():
                return f'{path.name}: {name} has other numbers'
        if len(rows) < len(original) and not reported:
            return f'{path.name}: {name} lacks rows, and nothing reports it'
    if not reported and found.channels.keys() != data.channels.keys():
        return f'{path.name}: a channel is missing, and nothing reports it'
    if not set(found.events) <= set(data.events) or (
            len(found.events) < len(data.events) and not reported):
        return f'{path.name}: other events'
    if found.configuration != data.configuration and not (reported and not found.configuration):
        return f'{path.name}: another configuration'
    return ''


def stored_rows(path: Path, copy: Path, data: RunData) -> str:
    """Return where what is read of a run, or of the copy of it, is not what another reader finds.

    Where something is reported to be wrong, what lies behind it, where the other reader ends, is
    the original's.
    """
    stored, fault = other_reading(path)
    whole = rows_of(data)
    for run in (path, copy):
        try:
            found = read_run(run)
        except DzRosError:
            continue
        reported = REPORTED_KEYS & found.info.keys()
        for name, rows in rows_of(found).items():
            there = stored.get(name, Counter())
            if reported:
                there = there | whole.get(name, Counter())
            if rows - there:
                return f'{run.name}: {name} has rows that are not stored'
            if not reported and there - rows:
                return f'{run.name}: {name} lacks rows, and nothing reports it'
        lacking = [name for name in stored if name not in found.channels]
        if lacking and not reported:
            return f'{run.name}: {lacking[0]} is not read, and nothing reports it'
        if fault and not reported and run == path:
            return f'{run.name}: read as if nothing were wrong, but {fault}'
    return ''


def rows_of(data: RunData) -> Rows:
    """Return the rows of a run in a form that can be counted."""
    return {name: Counter((channel.labels, row.tobytes()) for row in channel.values)
            for name, channel in data.channels.items()}


def other_reading(path: Path) -> tuple[Rows, str]:
    """Return what readers that are not ours find in the files of a run, and where they end."""
    from zstandard import ZstdDecompressor

    found: Rows = {}
    fault = ''
    files = [item for item in sorted(path.iterdir()) if item.suffix not in ('.yaml', '.txt')]
    with tempfile.TemporaryDirectory() as folder:
        for number, file in enumerate(files):
            plain = Path(folder, str(number))
            data = file.read_bytes()
            try:
                if data.startswith(b'\x28\xb5\x2f\xfd'):
                    with ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
                        data = reader.read(2**26)
                plain.write_bytes(data)
                read = sqlite_messages if data.startswith(b'SQLite') else mcap_messages
                for topic, payload in read(plain):
                    try:
                        if payload.startswith(b'\x28\xb5\x2f\xfd'):
                            payload = ZstdDecompressor().decompressobj().decompress(payload)
                        labels, values = array(payload)
                    except Exception as error:  # noqa: BLE001  this message; not those after it
                        fault = fault or f'{type(error).__name__}: {error}'
                        continue
                    found.setdefault(topic.rpartition('/')[2], Counter())[
                        labels, np.array(values, dtype=float).tobytes()] += 1
            except Exception as error:  # noqa: BLE001  readers raise what they like
                fault = fault or f'{type(error).__name__}: {error}'
    return found, fault


def sqlite_messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield (topic, payload) of the arrays in a database, of a damaged one by their numbers."""
    with closing(sqlite3.connect(f'{path.as_uri()}?mode=ro', uri=True)) as database:
        names = dict(database.execute(f"SELECT id, name FROM topics WHERE type = '{ARRAY_TYPE}'"))
        found, fault = {}, None
        for which, numbers in (('ORDER BY id', [()]), ('ORDER BY id DESC', [()]),
                               ('WHERE id = ?', [(number,) for number in range(MOST_IDS)])):
            for number in numbers if which == 'ORDER BY id' or fault else ():
                try:
                    for row in database.execute(
                            f'SELECT id, topic_id, data FROM messages {which}', number):
                        found[row] = row[1:]
                except sqlite3.Error as error:
                    fault = fault or error
        for topic, payload in found.values():
            if topic in names and isinstance(payload, bytes):
                yield names[topic], payload
        if fault is not None:
            raise fault


def without_metadata(data: bytes) -> bytes:
    """Return an MCAP file without metadata records, whose length mcap's reader does not look at.

    It holds no messages; one that is longer than its contents is no fault (MCAP, "Records").
    """
    kept, position = [data[:8]], 8
    while position + 9 <= len(data):
        opcode, length = struct.unpack_from('<BQ', data, position)
        end = min(position + 9 + length, len(data))
        if opcode != 0x0C:
            kept.append(data[position:end])
        position = end
    return b''.join((*kept, data[position:]))


def mcap_messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield (topic, payload) of the arrays in an MCAP file."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, str] = {}
    channels: dict[int, Any] = {}
    with io.BytesIO(without_metadata(path.read_bytes())) as file:
        for item in StreamReader(file, record_size_limit=2**28).records:
            if isinstance(item, Schema):
                schemas.setdefault(item.id, item.name)
            elif isinstance(item, Channel):
                channels.setdefault(item.id, item)
            elif isinstance(item, Message):
                channel = channels[item.channel_id]
                if schemas.get(channel.schema_id) == ARRAY_TYPE and (
                        channel.message_encoding == 'cdr'):
                    yield channel.topic, item.data


ARRAY_TYPE = 'std_msgs/msg/Float64MultiArray'
MOST_IDS = 2000
"""Numbers that messages of a base have, at most."""


@cache
def typestore() -> Any:
    """Return the messages of ROS 2 Jazzy, as rosbags has them."""
    from rosbags.typesys import get_typestore, Stores

    return get_typestore(Stores.ROS2_JAZZY)


def array(payload: bytes) -> tuple[tuple[str, ...], Any]:
    """Return the names and numbers of an array, by rosbags."""
    message = typestore().deserialize_cdr(payload, ARRAY_TYPE)
    return tuple(message.layout.dim[0].label.split(',')), message.data


def fuzz(seeds: range, seconds: float | None, saved: Path) -> list[str]:
    """Try the inputs of some seeds, for this time; return what was wrong."""
    wrong = []
    end = None if seconds is None else time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as name:
        bases = Bases(Path(name))
        done = 0
        for seed in seeds:
            if end is not None and time.monotonic() >= end:
                break
            folder = Path(name) / 'inputs'
            folder.mkdir()
            problem = check(seed, bases, folder)
            if problem:
                saved.mkdir(parents=True, exist_ok=True)
                kept = saved / f'seed-{seed}'
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(folder / kept.name, kept)
                wrong.append(f'seed {seed} ({kept}): {problem}')
            shutil.rmtree(folder)
            done += 1
    if end is not None:
        sys.stdout.write(f'{done} inputs, seeds {seeds[0]} to {seeds[0] + done - 1}\n')
    return wrong


def main() -> int:
    """Fuzz for as long as asked; return an exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--inputs', type=int, default=10 ** 9)
    parser.add_argument('--seed', type=int, default=None, help='first seed (default: the clock)')
    parser.add_argument('--save', type=Path, default=Path('fuzz-found'))
    arguments = parser.parse_args()
    first = arguments.seed if arguments.seed is not None else time.time_ns() // 1000 % 10 ** 9
    sys.stdout.write(f'first seed {first}\n')
    wrong = fuzz(range(first, first + arguments.inputs), arguments.seconds, arguments.save)
    for item in wrong:
        sys.stdout.write(f'{item}\n')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
