"""The loader: nothing read early, the same batches from any workers, nothing kept that is not whole."""

import multiprocessing
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synth3dlanes_baseline import loading
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.loading import (
    SLOT_BYTES,
    Process,
    Slots,
    decoding_of,
    open_examples,
    training_batches,
)
from synth3dlanes_baseline.workers import ahead

from synth3dlanes.system.errors import FormatError
from tests.baseline import roads

CPU = torch.device("cpu")


class Counted:
    """Samples that count, in memory shared with workers, how often each is read; labels and images may be read alone,
    as those of our data sets."""

    def __init__(self, samples, digest=None):
        self.samples, self._digest = samples, digest
        self.reads = {part: multiprocessing.Array("i", len(samples)) for part in ("whole", "image", "labels")}

    def __len__(self):
        return len(self.samples)

    def __getitem__(self, index):
        return self._read("whole", index)

    def _read(self, part, index):
        with self.reads[part].get_lock():
            self.reads[part][index] += 1
        return self.samples[index]

    def key(self, index):
        return self.samples[index].key

    def image(self, index):
        return self._read("image", index).image

    def labels(self, index):
        return self._read("labels", index).labels

    def digest(self):
        return self._digest

    def counts(self, part):
        return list(self.reads[part])


@pytest.fixture
def drawn():
    return roads.samples(np.random.default_rng(3), 10, (160, 120))


def _config(**overrides):
    return train_config("tiny", {"batch": 4, "device": "cpu", "workers": 0, **overrides})


def _batches(samples, folder, first=0, n_steps=5, process=None, is_on_device=False, **overrides):
    config, process = _config(**overrides), process or Process(0, 1, CPU)
    decoding = replace(decoding_of(len(samples), config, process), is_on_device=is_on_device)
    examples = open_examples(samples, decoding, config, process, folder)
    return list(training_batches(examples, config, process, first, n_steps))


def _equal(one, other):
    assert one.keys == other.keys
    for name in ("image", "intrinsics", "plane_pose", "target_pose"):
        assert getattr(one, name).equal(getattr(other, name)), name
    assert all(a.equal(b) for a, b in zip(one.curves, other.curves, strict=True))


def test_batches_do_not_depend_on_workers_caches_or_where_a_run_begins(drawn, tmp_path):
    whole = _batches(drawn, tmp_path)
    assert len(whole) == 5
    for overrides in ({"workers": 2}, {"workers": 1, "keep_decoded": False}, {"keep_decoded": False}):
        for one, other in zip(whole, _batches(drawn, tmp_path, **overrides), strict=True):
            _equal(one, other)
    for one, other in zip(whole[3:], _batches(drawn, tmp_path, first=3, workers=1), strict=True):
        _equal(one, other)


@pytest.mark.parametrize("workers", [0, 2])
def test_images_kept_on_the_device_make_the_same_batches(drawn, tmp_path, workers):
    """A GPU's memory; here the CPU's stands for it."""
    counted = Counted(drawn)
    kept = _batches(counted, tmp_path, first=2, n_steps=9, is_on_device=True, workers=workers)
    for one, other in zip(_batches(drawn, tmp_path, first=2, n_steps=9), kept, strict=True):
        _equal(one, other)
        assert other.image.is_contiguous(memory_format=torch.channels_last)
    if not workers:
        assert counted.counts("whole") == [1] * 10, "each image is decoded once"


def test_processes_share_the_batches_of_one_which_have_all_samples_in_every_epoch(drawn, tmp_path):
    alone, *pair = (
        _batches(drawn, tmp_path, n_steps=6, process=process)
        for process in (Process(0, 1, CPU), Process(0, 2, CPU), Process(1, 2, CPU))
    )
    for whole, first, second in zip(alone, *pair, strict=True):
        assert not set(first.keys) & set(second.keys)
        assert {*first.keys, *second.keys} == set(whole.keys)
    orders = [[key for batch in alone[at : at + 3] for key in batch.keys][:10] for at in (0, 3)]
    assert orders[0] != orders[1]
    assert sorted(orders[0]) == sorted(orders[1]) == [sample.key for sample in drawn], "every epoch has all samples"


def test_what_is_kept_is_read_once(drawn, tmp_path):
    n_epochs = 3
    n_steps = n_epochs * 5
    kept = Counted(drawn)
    _batches(kept, tmp_path, n_steps=n_steps, batch=2, workers=2, keep_decoded=True)
    # In the first of three epochs, two workers may meet the same sample before either has written all of it.
    reads = zip(*(kept.counts(part) for part in ("whole", "image", "labels")), strict=True)
    assert max(map(sum, reads)) <= 2
    streamed = Counted(drawn)
    _batches(streamed, tmp_path, n_steps=n_steps, batch=2, keep_decoded=False)
    assert set(streamed.counts("whole")) == {1}, "labels are kept even where images are not"
    assert set(streamed.counts("image")) == {n_epochs - 1}
    assert set(streamed.counts("labels")) == {0}


def test_annotations_outlive_a_run_only_for_the_same_samples(drawn, tmp_path):
    settings = {"keep_decoded": False, "n_steps": 5, "batch": 2}
    first, again, changed = Counted(drawn, "a"), Counted(drawn, "a"), Counted(drawn, "b")
    _batches(first, tmp_path, **settings)
    _batches(again, tmp_path, **settings)
    assert set(again.counts("whole")) == {0}
    assert set(again.counts("image")) == {1}
    _batches(changed, tmp_path, **settings)
    assert set(changed.counts("whole")) == {1}
    one, other = (_batches(Counted(drawn, "b"), tmp_path, **settings, **pose) for pose in ({}, {"fov_mask": True}))
    assert not all(a.curves.visible.equal(b.curves.visible) for a, b in zip(one, other, strict=True))


def test_a_damaged_slot_is_made_anew(drawn, tmp_path):
    whole = _batches(Counted(drawn, "a"), tmp_path)
    cache = tmp_path / "annotations.cache"
    content = bytearray(cache.read_bytes())
    for at in range(40_000, len(content), 1_000):
        content[at] ^= 0x55
    cache.write_bytes(bytes(content[:200_000]))
    for one, other in zip(whole, _batches(Counted(drawn, "a"), tmp_path), strict=True):
        _equal(one, other)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device without room")
def test_a_full_disk_costs_the_cache_and_not_the_run():
    slots = Slots(os.open("/dev/full", os.O_RDWR), SLOT_BYTES)
    slots.put(3, b"record")
    assert slots.get(3) is None


@pytest.mark.parametrize("workers", [0, 1])
def test_an_error_in_a_worker_is_one_line(drawn, tmp_path, workers):
    class Broken(Counted):
        def _read(self, part, index):
            if index == 7:
                raise FormatError("train/00000.tar: 00000007.jpg: expected a JPEG or PNG image, got none")
            return super()._read(part, index)

    with pytest.raises(FormatError) as raised:
        _batches(Broken(drawn), tmp_path, workers=workers)
    assert str(raised.value) == "train/00000.tar: 00000007.jpg: expected a JPEG or PNG image, got none"


def test_what_does_not_fit_is_told_with_figures(monkeypatch):
    monkeypatch.setattr(loading, "free_memory_bytes", lambda: 20 * 10**9)
    nano, process = train_config("nano", {"device": "cpu"}), Process(0, 1, CPU)
    few, many = (decoding_of(n, nano, process) for n in (2_000, 300_000))
    assert few.text() == "2,000 images, 1.0 GB when decoded: kept in memory"
    assert many.text() == (
        "300,000 images, 155.5 GB when decoded, with 20.0 GB of memory free: decoded again in every epoch"
    )
    assert decoding_of(12_000, nano, process).is_once
    assert not decoding_of(12_000, nano, Process(0, 8, CPU, neighbours=8)).is_once, "every process keeps its own"
    monkeypatch.setattr(loading, "free_gpu_bytes", lambda device: 80 * 10**9)
    text = "50,000 images, 25.9 GB when decoded: kept in memory of the GPU"
    assert decoding_of(50_000, nano, process).text() == text
    assert not decoding_of(300_000, nano, process).is_once
    off = train_config("nano", {"device": "cpu", "keep_decoded": False})
    assert not decoding_of(50_000, off, process).is_once


@pytest.mark.parametrize("n", [1, 3])
def test_items_come_in_order_and_few_are_made_ahead(n):
    made = []

    def items():
        for i in range(20):
            made.append(i)
            yield i

    for used, item in enumerate(ahead(items(), n), start=1):
        assert item == used - 1
        assert len(made) <= used + n
    assert made == list(range(20))


def test_an_error_comes_after_the_items_before_it_and_a_reader_may_leave():
    def items():
        yield from range(3)
        raise ValueError("the fourth")

    found = []
    with pytest.raises(ValueError, match="the fourth"):
        found.extend(ahead(items(), 2))
    assert found == [0, 1, 2]
    reading = ahead(items(), 2)
    assert [next(reading), next(reading)] == [0, 1]
    reading.close()
