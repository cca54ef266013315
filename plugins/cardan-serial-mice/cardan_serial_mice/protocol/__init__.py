"""The serial protocols of 3Dconnexion's older six-axis devices: Magellan, Spaceball, SpaceOrb."""

from cardan_serial_mice.protocol.magellan import (
    MagellanCompressedMotion as MagellanCompressedMotion,
    MagellanEcho as MagellanEcho,
    MagellanError as MagellanError,
    MagellanKeys as MagellanKeys,
    MagellanMotion as MagellanMotion,
    MagellanPacket as MagellanPacket,
    MagellanReader as MagellanReader,
    MagellanVersion as MagellanVersion,
    decode_magellan as decode_magellan,
    encode_magellan_keys as encode_magellan_keys,
    encode_magellan_motion as encode_magellan_motion,
)
from cardan_serial_mice.protocol.models import (
    SERIAL_MODELS as SERIAL_MODELS,
    Counts as Counts,
    SerialModel as SerialModel,
    button_mask as button_mask,
    from_hid_counts as from_hid_counts,
    keys_of_mask as keys_of_mask,
    model_of_firmware as model_of_firmware,
    model_of_version as model_of_version,
    serial_model_by_key as serial_model_by_key,
    to_hid_counts as to_hid_counts,
)
from cardan_serial_mice.protocol.spaceball import (
    SpaceballAdvancedKeys as SpaceballAdvancedKeys,
    SpaceballEcho as SpaceballEcho,
    SpaceballError as SpaceballError,
    SpaceballKeys as SpaceballKeys,
    SpaceballMotion as SpaceballMotion,
    SpaceballPacket as SpaceballPacket,
    SpaceballReader as SpaceballReader,
    SpaceballReset as SpaceballReset,
    decode_spaceball as decode_spaceball,
    encode_spaceball_keys as encode_spaceball_keys,
    encode_spaceball_motion as encode_spaceball_motion,
    escape as escape,
    unescape as unescape,
)
from cardan_serial_mice.protocol.spaceorb import (
    OrbError as OrbError,
    OrbKeys as OrbKeys,
    OrbMotion as OrbMotion,
    OrbPacket as OrbPacket,
    OrbReader as OrbReader,
    OrbReset as OrbReset,
    OrbText as OrbText,
    decode_orb as decode_orb,
    encode_orb_error as encode_orb_error,
    encode_orb_keys as encode_orb_keys,
    encode_orb_motion as encode_orb_motion,
    encode_orb_reset as encode_orb_reset,
    encode_orb_text as encode_orb_text,
)
from cardan_serial_mice.protocol.values import (
    CommandReader as CommandReader,
    Malformed as Malformed,
)
