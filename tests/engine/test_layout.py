import numpy as np
import pytest
from prt_baker.addon.prt import layout
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout

FITTING = [Layout(order, 1) for order in range(2, 6)] + [Layout(order, 3) for order in range(2, 5)]


def test_one_channel_with_its_residual_wastes_no_slot():
    names = (*(f"T{i}" for i in range(9)), "R0r", "R0g", "R0b")
    assert Layout(3, residual=True).slots == names
    assert Layout(3, residual=True).attributes == ("_PRT_0", "_PRT_1", "_PRT_2")


def test_three_channels_stand_side_by_side():
    assert Layout(2, 3).slots[:5] == ("T0r", "T0g", "T0b", "T1r", "T1g")


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("lights", range(5))
@pytest.mark.parametrize("packing", FITTING)
def test_slots_fill_whole_attributes_and_only_the_end_is_unused(packing, lights, residual):
    packing = Layout(packing.order, packing.channels, residual, lights)
    used = packing.transfer_slots + 3 * residual + lights
    assert len(packing.slots) == 4 * len(packing.attributes)
    assert all(packing.slots[:used])
    assert not any(packing.slots[used:])
    assert len(packing.slots) - used < 4
    assert len(set(packing.slots[:used])) == used


@pytest.mark.parametrize("packing", FITTING)
def test_what_is_packed_unpacks_equal(packing):
    shape = (7, packing.channels, packing.order**2)
    transfer = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    values = layout.pack(packing, transfer)
    assert values.dtype == np.float32
    np.testing.assert_array_equal(layout.unpack(packing, values), transfer)


@pytest.mark.parametrize("packing", FITTING)
def test_every_float_is_what_its_slot_says(packing):
    shape = (2, packing.channels, packing.order**2)
    transfer = np.arange(1, 1 + np.prod(shape), dtype=np.float32).reshape(shape)
    values = layout.pack(packing, transfer)
    for slot, name in enumerate(packing.slots):
        channel = max("rgb".find(name[-1:]), 0) if packing.channels == 3 else 0
        digits = name.strip("Trgb")
        expected = transfer[:, channel, int(digits)] if name else 0
        np.testing.assert_array_equal(values[:, slot], expected)


def test_an_object_without_elements_is_packed_too():
    values = layout.pack(Layout(3), np.empty((0, 1, 9), np.float32))
    assert values.shape == (0, 12)
    assert layout.unpack(Layout(3), values).shape == (0, 1, 9)


def test_what_eevee_reads_is_let_through():
    for packing in FITTING:
        layout.check(packing)
    layout.check(Layout(4, 3, residual=True))
    layout.check(Layout(3), others=11)


def test_what_eevee_cannot_read_is_refused_in_a_sentence():
    with pytest.raises(BakeError, match=r"19 vertex attributes.*at most 14: choose a lower order"):
        layout.check(Layout(5, 3))
    with pytest.raises(BakeError, match="3 vertex attributes beside the 12 that material 'Wall'"):
        layout.check(Layout(3), others=12, material="Wall")
