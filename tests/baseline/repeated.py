"""Make a large data set of a small one, by repeating its samples under new keys; for the loader at full size.

python -m tests.baseline.repeated DIR/SPLIT OUT N
"""

import hashlib
import json
import sys
from itertools import islice
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from synth3dlanes.dataset.description import DESCRIPTION
from synth3dlanes.dataset.format import key_of, tar_bytes, tar_end
from synth3dlanes.dataset.index import place_columns
from synth3dlanes.dataset.read import Reader

SHARD_SIZE = 1000


def repeat(source: Reader, out: Path, n: int) -> None:
    """Write `out`/train with n samples, which are those of `source` again and again."""
    rows = source.index.to_pylist()
    members = [source.raw(i) for i in range(len(source))]
    split = out / "train"
    split.mkdir(parents=True)
    description = {**source.description, "shard_size": SHARD_SIZE, "splits": {"train": {"n": n}}}
    (out / DESCRIPTION).write_text(json.dumps(description))
    keys = iter(range(n))
    while shard := list(islice(keys, SHARD_SIZE)):
        path = split / f"{shard[0] // SHARD_SIZE:05d}"
        made, offset = [], 0
        with path.with_suffix(".tar").open("wb") as tar:
            for index in shard:
                i = index % len(rows)
                data = tar_bytes(key_of(index), members[i])
                row = rows[i] | {"key": key_of(index), "index": index, "sha256": hashlib.sha256(data).hexdigest()}
                shift = offset - min(rows[i][name] for name in place_columns(tuple(members[i])) if "offset" in name)
                for name in place_columns(tuple(members[i])):
                    row[name] += (shift + 512) * ("offset" in name)
                made.append(row)
                tar.write(data)
                offset += len(data)
            tar.write(tar_end(offset))
        pq.write_table(pa.Table.from_pylist(made, schema=source.index.schema), path.with_suffix(".parquet"))


if __name__ == "__main__":
    repeat(Reader(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
