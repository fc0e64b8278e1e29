"""XCDR1 little endian: the rules that all types of fields share.

Source: OMG DDSI-RTPS 2.2, chapter 10, and OMG CORBA 3.0, section 15.3 (CDR).
"""

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""The encapsulation, in front of each encoding. Readers ignore its last two bytes."""
ENCAPSULATION_SIZE = len(CDR_LITTLE_ENDIAN)
LARGEST_ALIGNMENT = 8
MAX_TRAILING_BYTES = 3  # some writers pad a message to a multiple of four


def padding(position: int, alignment: int) -> int:
    """Return the bytes to skip from `position`, counted from the encapsulation, to an aligned one.

    Alignment counts from the body behind the encapsulation.
    """
    return (ENCAPSULATION_SIZE - position) % alignment
