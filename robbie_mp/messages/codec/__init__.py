"""XCDR1 little endian: what makes, encodes, measures and decodes the messages of each type."""
