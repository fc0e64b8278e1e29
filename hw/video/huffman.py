"""Huffman tables for JPEG images of cameras, which leave them out.

Source: ITU-T T.81 (JPEG), Annex K.3.3; USB Device Class Definition for Video Devices: MJPEG payload.
"""

# DC and AC table of the brightness, then of the colours: class and number, 16 counts, the values.
_TABLES = bytes.fromhex(
    "0000010501010101010100000000000000000102030405060708090a0b100002010303020403050504040000017d0102"
    "0300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a"
    "3435363738393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92"
    "939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4"
    "e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa0100030101010101010101010000000000000102030405060708090a0b110002"
    "0102040403040705040400010277000102031104052131061241510761711322328108144291a1b1c109233352f01562"
    "72d10a162434e125f11718191a262728292a35363738393a434445464748494a535455565758595a636465666768696a"
    "737475767778797a82838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5"
    "c6c7c8c9cad2d3d4d5d6d7d8d9dae2e3e4e5e6e7e8e9eaf2f3f4f5f6f7f8f9fa"
)
_START, _TABLES_MARK, _SCAN_MARK = b"\xff\xd8", 0xC4, 0xDA
_SEGMENT = b"\xff\xc4" + (len(_TABLES) + 2).to_bytes(2, "big") + _TABLES


def with_huffman_tables(image: bytes) -> bytes:
    """Return a JPEG image with the usual Huffman tables, if it has none.

    Bytes that are no JPEG image are returned as they are.
    """
    if not image.startswith(_START):
        return image
    position = len(_START)
    while position + 4 <= len(image) and image[position] == 0xFF:
        mark = image[position + 1]
        if mark == _TABLES_MARK:
            return image
        if mark == _SCAN_MARK:
            return image[:position] + _SEGMENT + image[position:]
        position += 2 + int.from_bytes(image[position + 2 : position + 4], "big")
    return image
