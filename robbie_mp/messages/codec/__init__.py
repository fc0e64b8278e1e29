"""XCDR1 little endian, generated: for each message type its own encoder, decoder, sizer and constructor."""
