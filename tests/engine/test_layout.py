from dataclasses import asdict

import numpy as np
import pytest
from prt_baker.addon.prt import layout
from prt_baker.addon.prt.errors import BakeError
from prt_baker.addon.prt.layout import Layout, Values
from prt_baker.addon.prt.results import ReceiverResult

FITTING = [Layout(order, 1) for order in range(1, 6)] + [Layout(order, 3) for order in range(2, 5)]


def made_up(packing, count=7):
    """Values of ``packing``, every float another one."""
    shapes = (packing.channels, packing.order**2), (packing.turns, 3), (packing.lights,)
    shapes += ((packing.visibility_order**2,),)
    numbers = iter(range(1, 10**6))
    return Values(
        *(
            np.array([next(numbers) for _ in range(count * np.prod(shape))], np.float32).reshape(
                count, *shape
            )
            for shape in shapes
        )
    )


def assert_equal(found, expected):
    for name in ("transfer", "residual", "visibility", "visibility_sh"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_one_channel_with_its_residual_wastes_no_slot():
    names = (*(f"T{i}" for i in range(9)), "R0r", "R0g", "R0b")
    assert Layout(3, turns=1).slots == names
    assert Layout(3, turns=1).attributes == ("_PRT_0", "_PRT_1", "_PRT_2")


def test_three_channels_stand_side_by_side():
    assert Layout(2, 3).slots[:5] == ("T0r", "T0g", "T0b", "T1r", "T1g")


def test_residuals_and_visibilities_follow_in_order():
    names = ("R0r", "R0g", "R0b", "R1r", "R1g", "R1b", "S0", "S1")
    assert Layout(2, turns=2, lights=2).slots[4:] == names
    seen = tuple(f"V{i}" for i in range(9))
    assert Layout(2, turns=2, lights=2, visibility_order=3).slots[4:-3] == names + seen


@pytest.mark.parametrize("seen", [0, 3])
@pytest.mark.parametrize("turns", [0, 1, 3])
@pytest.mark.parametrize("lights", range(5))
@pytest.mark.parametrize("packing", FITTING)
def test_slots_fill_whole_attributes_and_only_the_end_is_unused(packing, lights, turns, seen):
    packing = Layout(packing.order, packing.channels, turns, lights, seen)
    used = packing.transfer_slots + 3 * turns + lights + seen**2
    assert len(packing.slots) == 4 * len(packing.attributes)
    assert all(packing.slots[:used])
    assert not any(packing.slots[used:])
    assert len(packing.slots) - used < 4
    assert len(set(packing.slots[:used])) == used


@pytest.mark.parametrize("seen", [0, 2, 5])
@pytest.mark.parametrize("turns", [0, 1, 3])
@pytest.mark.parametrize("lights", [0, 2])
@pytest.mark.parametrize("packing", FITTING)
def test_what_is_packed_unpacks_equal(packing, lights, turns, seen):
    packing = Layout(packing.order, packing.channels, turns, lights, seen)
    values = made_up(packing)
    packed = layout.pack(packing, values)
    assert packed.dtype == np.float32
    assert_equal(layout.unpack(packing, packed), values)


@pytest.mark.parametrize(
    "packing", [Layout(3, 1, 2, 3), Layout(2, 3, 1, 1, 3), Layout(5), Layout(1)]
)
def test_every_float_is_what_its_slot_says(packing):
    values = made_up(packing, 2)
    packed = layout.pack(packing, values)
    for slot, name in enumerate(packing.slots):
        channel = max("rgb".find(name[-1:]), 0)
        digits = int(name.strip("TRSVrgb") or 0)
        expected = {
            "T": lambda: values.transfer[:, channel, digits],  # noqa: B023
            "R": lambda: values.residual[:, digits, channel],  # noqa: B023
            "S": lambda: values.visibility[:, digits],  # noqa: B023
            "V": lambda: values.visibility_sh[:, digits],  # noqa: B023
            "": lambda: 0,
        }[name[:1]]()
        np.testing.assert_array_equal(packed[:, slot], expected, err_msg=name)


def test_an_object_without_elements_is_packed_too():
    packing = Layout(3, turns=1, lights=1)
    packed = layout.pack(packing, made_up(packing, 0))
    assert packed.shape == (0, 16)
    assert layout.unpack(packing, packed).transfer.shape == (0, 1, 9)


def test_what_stores_less_is_packed_beside_what_stores_more():
    packing = Layout(3, 3, turns=2, visibility_order=3)
    little = made_up(Layout(2))
    found = layout.unpack(packing, layout.pack(packing, little))
    for channel in range(3):
        np.testing.assert_array_equal(found.transfer[:, channel, :4], little.transfer[:, 0])
    assert not found.transfer[:, :, 4:].any()
    assert not found.residual.any()
    np.testing.assert_allclose(found.visibility_sh[:, 0], np.sqrt(4 * np.pi))  # all is seen
    assert not found.visibility_sh[:, 1:].any()


def test_the_layout_that_covers_results_is_that_of_the_largest():
    elements = np.arange(7, dtype=np.int32)
    results = [
        ReceiverResult(
            "",
            transfer=values.transfer,
            element_points=elements,
            residual=values.residual,
            visibility=values.visibility,
            visibility_sh=values.visibility_sh,
        )
        for values in map(made_up, (Layout(2, 3), Layout(4, 1, 12), Layout(1, 1, 0, 2, 3)))
    ]
    assert layout.covering(results) == Layout(4, 3, 12, 2, 3)
    assert layout.covering(results[:1]) == Layout(2, 3)
    assert_equal(layout.at_elements(results[1]), made_up(Layout(4, 1, 12)))


def test_layouts_of_older_files_are_read():
    old = {"order": 3, "channels": 1, "lights": 0, "residual": False}
    assert Layout.of(old) == Layout(3)
    assert Layout.of({**old, "residual": True}) == Layout(3, turns=1)
    assert Layout.of(asdict(Layout(4, 3, 2, 1, 3))) == Layout(4, 3, 2, 1, 3)


def test_a_layout_between_two_has_every_part_between_theirs():
    most = Layout(3, 1, 1, 4)
    assert all(Layout(3, 1, 1, lights).between(Layout(3, 1, 1), most) for lights in range(5))
    others = (
        Layout(2, 1, 1),
        Layout(3),
        Layout(3, 3, 1),
        Layout(3, 1, 1, 5),
        Layout(3, 1, 1, 0, 2),
    )
    for other in others:
        assert not other.between(Layout(3, 1, 1), most)


def test_what_eevee_reads_is_let_through():
    for packing in FITTING:
        layout.check(packing)
    layout.check(Layout(4, 3, turns=1))
    layout.check(Layout(3, turns=12))
    layout.check(Layout(3), others=11)


@pytest.mark.parametrize("seen", [0, 3, 5])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_what_a_bake_with_occlusion_of_reflections_takes(order, channels, seen):
    """With the residual, and where it lets a material read one UV map besides."""
    packing = Layout(order, channels, 1, 0, seen)
    count = TAKEN[channels, seen].get(order)
    if count is None:
        with pytest.raises(BakeError, match="takes"):
            layout.check(packing)
    else:
        assert len(packing.attributes) == count
        layout.check(packing)
        with pytest.raises(BakeError, match="beside the"):
            layout.check(packing, layout.MAX_ATTRIBUTES - count + 1, "Wall")


TAKEN = {  # attributes, by channels and order of the visibility, then by order
    (1, 0): {2: 2, 3: 3, 4: 5, 5: 7},
    (1, 3): {2: 4, 3: 6, 4: 7, 5: 10},
    (1, 5): {2: 8, 3: 10, 4: 11, 5: 14},
    (3, 0): {2: 4, 3: 8, 4: 13},
    (3, 3): {2: 6, 3: 10},
    (3, 5): {2: 10, 3: 14},
}


@pytest.mark.parametrize(
    ("packing", "others", "words"),
    [
        (
            Layout(5, 3),
            0,
            "order 5 with 3 channels and .* takes 19 .* 14: choose a lower order or no bounces$",
        ),
        (Layout(3), 12, "3 vertex attributes beside the 12 that material 'Wall' reads"),
        (Layout(3, turns=24), 0, "24 turns takes 21 .*: choose a lower order or fewer turns$"),
        (Layout(3, 1, 1, 1), 11, "1 peak takes 4 .*: choose a lower order or fewer peaks or no r"),
        (
            Layout(3, 1, 1, 0, 3),
            9,
            "occlusion of reflections takes 6 .*no occlusion of reflections",
        ),
        (Layout(2, turns=1), 13, ": choose no residual \\(Exact at This World\\)$"),
        (Layout(2), 14, "order 2 with no residual takes 1 vertex .*: let the material read fewer$"),
    ],
)
def test_what_eevee_cannot_read_is_refused_with_what_to_lower(packing, others, words):
    with pytest.raises(BakeError, match=words) as refusal:
        layout.check(packing, others, "Wall")
    assert "\n" not in str(refusal.value)
