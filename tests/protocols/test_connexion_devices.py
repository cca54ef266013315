"""The device table, and the descriptors made from it."""

import pytest
from hypothesis import given, strategies as st
from pyspacemouse.loader import get_device_specs

from cardan.protocols.connexion.descriptors import descriptor_for, full_scale_of
from cardan.protocols.connexion.devices import (
    MODELS,
    NEVER_OPEN,
    V3DK,
    Family,
    find_model,
    is_candidate,
    model_by_key,
)

SPACE_NAVIGATOR_AXES = bytes.fromhex(
    "05010908a101a100850116a2fe265e013688fa467805550c65110930093109327510950381 06c0".replace(
        " ", ""
    )
    + "a1008502093309340935751095038106c0"
)


def test_ids_and_keys_are_unique():
    assert len({(m.vendor_id, m.product_id) for m in MODELS}) == len(MODELS)
    assert len({m.key for m in MODELS}) == len(MODELS)
    assert not NEVER_OPEN & {(m.vendor_id, m.product_id) for m in MODELS}


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.key)
def test_every_model_is_found_and_consistent(model):
    assert find_model(model.vendor_id, model.product_id) is model
    assert model_by_key(model.key) is model
    assert is_candidate(model.vendor_id, model.product_id, 1, 8)
    assert is_candidate(model.vendor_id, model.product_id, 0, 0)
    assert len(set(model.buttons.values())) == len(model.buttons)
    if not model.key_array:
        needed = 1 + (max(model.buttons, default=-1) + 8) // 8
        assert model.button_report_bytes >= needed or not model.buttons


def test_pro_buttons_are_the_published_mask():
    for key in ("spacemouse-pro", "spacemouse-pro-wireless", "spacemouse-pro-wireless-bt"):
        model = model_by_key(key)
        assert sum(1 << bit for bit in model.buttons) == 0x07C0F137
        assert model.buttons[4] == "right"
        assert model.buttons[12] == "1"
        assert model.buttons[26] == "rotate-lock"
    assert sum(1 << bit for bit in model_by_key("spacepilot-pro").buttons) == 0x7FFFFFFF


def test_v3dk_numbers():
    assert [V3DK[code] for code in (1, 2, 13, 22, 23, 27, 31, 36, 41, 52)] == [
        *("menu", "fit", "1", "10", "esc", "rotate-lock", "minus", "enter", "f1", "f12"),
    ]
    assert [V3DK[code] for code in (77, 78, 103, 139, 141, 175, 176, 229, 232)] == [
        *("11", "12", "v1", "save-v1", "save-v3", "tab", "space", "numpad-f1", "numpad-f4"),
    ]


def test_unknown_names():
    assert find_model(0x256F, 0xFFFF) is None
    with pytest.raises(KeyError):
        model_by_key("spaceship")


@pytest.mark.parametrize(
    ("ids", "usage", "expected"),
    [
        ((0x256F, 0xC6FF), (1, 8), True),  # a product newer than the table
        ((0x256F, 0xC6FF), (0, 0), False),  # the same, from a system that hides usages
        ((0x256F, 0xC652), (0xFF00, 1), False),  # silent collection of the receiver
        ((0x046D, 0xC626), (1, 6), False),
        ((0x046D, 0xC52B), (1, 8), False),  # Logitech sells other devices, too
        ((0x256F, 0xC650), (1, 8), False),  # a mouse
        ((0x256F, 0xC671), (1, 8), False),
        ((0x1234, 0xC626), (1, 8), False),
    ],
)
def test_candidates(ids, usage, expected):
    assert is_candidate(*ids, *usage) is expected


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.key)
def test_descriptor_declares_the_full_scale(model):
    assert full_scale_of(descriptor_for(model)) == 350
    assert full_scale_of(descriptor_for(model._replace(full_scale=512))) == 512
    assert full_scale_of(descriptor_for(model._replace(full_scale=0))) is None


def test_descriptor_of_the_space_navigator_is_the_published_one():
    assert descriptor_for(model_by_key("spacenavigator")).startswith(SPACE_NAVIGATOR_AXES)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.key)
def test_descriptor_is_balanced(model):
    """Each collection is closed, each report is declared, and button bits fill whole bytes."""
    descriptor = descriptor_for(model)
    depth, position, report_id, report_size, count = 0, 0, 0, 0, 0
    input_bits = {}
    while position < len(descriptor):
        prefix = descriptor[position]
        size = (0, 1, 2, 4)[prefix & 3]
        value = int.from_bytes(descriptor[position + 1 : position + 1 + size], "little")
        position += 1 + size
        tag = prefix & 0xFC
        if tag == 0xA0:
            depth += 1
        elif tag == 0xC0:
            depth -= 1
            assert depth >= 0
        elif tag == 0x84:
            report_id = value
        elif tag == 0x74:
            report_size = value
        elif tag == 0x94:
            count = value
        elif tag == 0x80:
            input_bits[report_id] = input_bits.get(report_id, 0) + report_size * count
    assert depth == 0
    expected = {1: 48, 2: 48} if model.family is Family.SPLIT else {1: 96}
    if model.buttons:
        expected[3] = 8 * (model.button_report_bytes - 1)
    if model.key_array:
        expected.update({0x1C: 96, 0x1D: 96})
    if model.battery:
        expected[0x17] = 16
    assert input_bits == expected


@given(st.binary(max_size=300))
def test_full_scale_of_any_bytes(data):
    value = full_scale_of(data)
    assert value is None or value > 0


@given(st.integers(0, 110), st.integers(0, 255))
def test_full_scale_of_damaged_descriptors(position, byte):
    descriptor = bytearray(descriptor_for(model_by_key("spacenavigator")))
    descriptor[position] = byte
    value = full_scale_of(bytes(descriptor))
    assert value is None or value > 0
    assert full_scale_of(bytes(descriptor[:position])) in (None, value, 350)


# PySpaceMouse's names for the same bits. Two of its tables are known to be wrong: bit 4 of the
# Pro is the RIGHT key, not REAR, and SpacePilot Pro's keys 1 and 2 are V3DK 13 and 14.
SYNONYMS = {
    "rotation": "rotate-lock", "lock": "rotate-lock", "rear": "right", "t": "top", "l": "left",
    "r": "right", "f": "front", "2d": "2d", "dom": "dominant", "lock_3d": "3d-lock",
    "zoom_minus": "plus", "zoom_plus": "minus", "roll_cw": "roll-cw", "iso1": "iso1",
}  # fmt: skip


def _shared_specs():
    for spec in get_device_specs().values():
        model = find_model(spec.vendor_id, spec.product_id)
        if model is not None:
            yield pytest.param(spec, model, id=model.key)


SHARED = list(_shared_specs())


@pytest.mark.parametrize(("spec", "model"), SHARED)
def test_table_agrees_with_pyspacemouse(spec, model):
    channels = {axis.channel for axis in spec.mappings.values()}
    assert channels == ({1, 2} if model.family is Family.SPLIT else {1})
    assert (spec.vendor_id, spec.product_id) not in NEVER_OPEN
    if model.key == "spacepilot-pro":
        return
    for name, button in zip(spec.button_names, spec.button_specs, strict=True):
        label = name.lower().removeprefix("btn_")
        assert button.channel == 3
        bit = 8 * (button.byte - 1) + button.bit
        assert model.buttons[bit] == SYNONYMS.get(label, label)


def test_pyspacemouse_shares_most_of_the_table():
    assert len(SHARED) >= 12
