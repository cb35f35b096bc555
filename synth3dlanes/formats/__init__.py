"""Foreign data set formats, a folder each: its convention (camera, axes), writer, reader, score and self-check.

`export` writes a whole data set, `verify` checks what it wrote. Foreign frames and keys exist here and nowhere else.
"""
