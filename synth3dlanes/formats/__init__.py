"""Foreign data set formats, a file each: its convention (camera, axes), writer, reader, comparison and benchmark.

`export` writes a whole data set, `verify` compares it with the labels, `scoring` scores predictions; `registry` finds
the formats. Foreign frames and keys exist here and nowhere else.
"""
