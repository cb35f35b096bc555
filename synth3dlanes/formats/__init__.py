"""Foreign data set formats, a folder each: its convention (camera, axes), writer, reader and check.

`export` writes a whole data set, `verify` compares it with the labels, `scoring` scores predictions; `registry` finds
the formats. Foreign frames and keys exist here and nowhere else.
"""
