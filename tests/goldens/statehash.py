"""One hash of a reader's state at a frame; conformance/README.md defines the bytes."""

from __future__ import annotations

import hashlib
import struct

from tests.support.slots.plain import Held

EMPTY, UNKNOWN, ON_LATTICE, ESCAPED = range(4)
LOGIT_BYTES = slice(4 * 10, 4 * 11)
"""Bytes of the logit in the floats mean, log-scales, quaternion, logit, coefficients."""


def state_sha256(found: Held) -> str:
    """The hash of layers 0..n-1 of each lane; n is the number of layers in `found`."""
    slots = (slot for lane in found for layer in lane for slot in layer)
    return hashlib.sha256(b"".join(map(_slot_bytes, slots))).hexdigest()


def _slot_bytes(slot: object) -> bytes:
    match slot:
        case "empty":
            return bytes([EMPTY])
        case "unknown":
            return bytes([UNKNOWN])
        case (int(start), None, bytes(floats)):
            return struct.pack("<Bi", ESCAPED, start) + floats
        case (int(start), (*position_and_signed, opacity), bytes(floats)):
            integers = struct.pack("<3i", *position_and_signed[:3])
            attributes = struct.pack(
                f"<{len(position_and_signed) - 3}bB", *position_and_signed[3:], opacity
            )
            # The rounding of ln differs between platforms; the integer is the opacity.
            exact = floats[: LOGIT_BYTES.start] + floats[LOGIT_BYTES.stop :]
            return struct.pack("<Bi", ON_LATTICE, start) + integers + attributes + exact
    raise TypeError(f"not a slot: {slot!r}")
