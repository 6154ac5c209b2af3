# SPDX-License-Identifier: Apache-2.0
"""PDO layout: what is written where, and the bytes on the bus."""

import struct

import pytest

from dz_ros.drivers.cia402.objects import dictionary, EMULATED, layout, NO_RTR, STANDARD


def test_torque_command_as_bytes():
    command, _, _ = layout('torque', False, True)
    assert command.cob_id(5) == 0x205
    assert struct.pack(command.form, 0x000F, -500) == bytes.fromhex('0f000cfe')


def test_velocity_command_as_bytes():
    command, _, _ = layout('velocity', True, True)
    assert command.kind == 1
    assert struct.pack(command.form, 0x0007, 1_000_000) == bytes.fromhex('070040420f00')


def test_answers_as_bytes():
    _, first, second = layout('torque', False, True)
    assert (first.cob_id(127), second.cob_id(127)) == (0x1FF, 0x2FF)
    assert struct.unpack(first.form, bytes.fromhex('3712feffffff0a')) == (0x1237, -2, 10)
    assert struct.unpack(second.form, bytes.fromhex('00000080e8ff')) == (-2 ** 31, -24)


def test_without_velocity_there_is_one_answer():
    assert layout('torque', False, False)[2] is None


def test_a_pdo_is_switched_off_while_it_is_mapped():
    command, _, _ = layout('torque', False, True)
    assert command.records(1, 100) == [
        (0x1400, 1, 0x80000201), (0x1400, 2, 255), (0x1400, 5, 100), (0x1600, 0, 0),
        (0x1600, 1, 0x60400010), (0x1600, 2, 0x60710010), (0x1600, 0, 2), (0x1400, 1, 0x201)]
    _, first, second = layout('velocity', False, True)
    assert [value for index, _, value in first.records(1) if index == 0x1A00] == [
        0, 0x60410010, 0x60640020, 0x60610008, 3]
    assert [value for index, sub, value in command.records(1, kept=NO_RTR)
            if (index, sub) == (0x1400, 1)] == [0xC0000201, 0x40000201]
    assert second.records(3)[0] == (0x1801, 1, 0x80000283)
    assert [value for index, _, value in second.records(1) if index == 0x1A01] == [
        0, 0x606C0020, 0x60770010, 2]


@pytest.mark.parametrize(('mode', 'sync', 'velocity'), [
    (mode, sync, velocity) for mode in ('torque', 'velocity') for sync in (False, True)
    for velocity in (False, True)])
def test_each_pdo_fits_a_frame_and_its_struct_its_mapping(mode, sync, velocity):
    for pdo in layout(mode, sync, velocity):
        if pdo is not None:
            bits = sum(item.bits for item in pdo.objects)
            assert struct.calcsize(pdo.form) * 8 == bits <= 64


def test_the_dictionary_has_every_object_at_its_place_and_length():
    pytest.importorskip('canopen', reason='canopen is not installed')
    found = dictionary(EMULATED)
    for item in (*STANDARD, *EMULATED):
        entry = found[item.index]
        entry = entry[item.sub] if item.sub else entry
        assert len(entry) == item.bits
        assert entry.index == item.index
        assert entry.subindex == item.sub
    assert found[0x1600][0].default == 0
    assert found[0x1402][1].default == 0x80000400
    assert not found[0x6041].writable
