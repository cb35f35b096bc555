"""The device asked for or an error, never another; each worker sees one GPU, and none that a scheduler has hidden."""

import os
import tempfile
from dataclasses import replace

import pytest

from synth3dlanes.production import devices
from synth3dlanes.production.devices import default_workers, masks, may_have_gpu, resolve_device
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.production.workers import Limits, Outcome, Pool
from synth3dlanes.scene.settings import DEVICES, Device, RenderSettings, choose_device
from synth3dlanes.system.errors import DiskFullError, InputError, WorkerError
from tests import fake_samples

CPU = Device("cpu", "AMD EPYC")
TWO_NVIDIA = [CPU, *(Device(kind, f"NVIDIA H200 {i}") for kind in ("cuda", "optix") for i in range(2))]
RADEON = [CPU, Device("hip", "Radeon")]


@pytest.mark.parametrize(
    ("found", "best"),
    [
        ([CPU], "cpu"),
        ([], "cpu"),
        (TWO_NVIDIA, "optix"),
        ([CPU, Device("cuda", "GTX 960")], "cuda"),
        (RADEON, "hip"),
        ([CPU, Device("oneapi", "Arc A770")], "oneapi"),
        ([Device("metal", "M2")], "metal"),
    ],
)
def test_auto_takes_the_best_and_a_name_takes_that_or_fails(found, best):
    assert choose_device("auto", found) == best
    for asked in DEVICES[1:]:
        if asked == "cpu" or asked in {device.kind for device in found}:
            assert choose_device(asked, found) == asked
        else:
            with pytest.raises(InputError, match=f"device: expected {asked} on this machine, found") as error:
                choose_device(asked, found)
            assert all(device.name in str(error.value) for device in found)


def test_each_gpu_has_a_mask_of_its_own_and_that_of_a_scheduler_is_divided_not_widened():
    assert masks("cpu", TWO_NVIDIA, {}) == masks("metal", [Device("metal", "M2")], {}) == [{}]
    assert masks("hip", RADEON, {}) == [{"HIP_VISIBLE_DEVICES": "0"}]
    for kind in ("cuda", "optix"):
        for given, numbers in (({}, ("0", "1")), ({"CUDA_VISIBLE_DEVICES": "5,GPU-8f3c"}, ("5", "GPU-8f3c"))):
            assert masks(kind, TWO_NVIDIA, given) == [{"CUDA_VISIBLE_DEVICES": number} for number in numbers]


def test_workers_fill_cores_or_gpus():
    assert default_workers("cpu", 0, 12) == 12
    assert default_workers("optix", 2, 64) == 8
    assert default_workers("optix", 2, 3) == 3


@pytest.mark.fresh
def test_workers_take_turns_with_the_gpus():
    shown = [{"CUDA_VISIBLE_DEVICES": "0"}, {"CUDA_VISIBLE_DEVICES": "1"}]
    with Pool(4, Limits(), masks=shown) as pool:
        for task in range(4):
            pool.start(task, os.getenv, "CUDA_VISIBLE_DEVICES")
        values = []
        while pool.busy:
            values += [outcome.value for outcome in pool.wait(1.0)]
    assert sorted(values) == ["0", "0", "1", "1"]


def test_what_became_of_a_task_is_an_error_by_name():
    assert Outcome("a", "done", 7).result("x") == 7
    kinds = {"full": DiskFullError, "failed": WorkerError, "killed": WorkerError, "broken": WorkerError}
    for status, kind in kinds.items():
        with pytest.raises(kind) as caught:
            Outcome("a", status, reason="why", stderr="last words").result("x")
        assert (str(caught.value), caught.value.__notes__) == ("x: why", ["last words"])


@pytest.mark.fresh
def test_two_pools_on_a_machine_take_different_cores(monkeypatch, tmp_path):
    # Other runs on this machine have their leases elsewhere.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Pool(1, Limits()) as one, Pool(1, Limits()) as other:
        cores = []
        for pool in (one, other):
            pool.start("cores", os.sched_getaffinity, 0)
            cores += [outcome.value for outcome in pool.wait(30.0)]
    assert len({*map(frozenset, cores)}) == min(2, len(os.sched_getaffinity(0)))


@pytest.mark.render
def test_a_run_fails_before_it_begins_where_the_device_is_absent(tmp_path):
    recipe = replace(fake_samples.recipe(), settings=RenderSettings(device="metal"))
    with pytest.raises(InputError, match=r"device: expected metal on this machine, found .*cpu \("):
        generate(Plan(tmp_path / "out", 4, recipe), print)
    assert not (tmp_path / "out").exists()


@pytest.mark.render
def test_the_device_found_is_part_of_the_recipe(monkeypatch):
    auto = replace(fake_samples.recipe(), settings=RenderSettings(device="auto"))
    monkeypatch.setattr(devices, "_ask", lambda asked: tuple(TWO_NVIDIA))
    monkeypatch.setattr(devices, "may_have_gpu", lambda: True)
    recipe, slots = resolve_device(auto)
    assert recipe.description()["render"]["device"] == "optix"
    assert slots.names == ("NVIDIA H200 0", "NVIDIA H200 1")
    assert len(slots.masks) == 2
    monkeypatch.undo()
    assert resolve_device(replace(auto, settings=RenderSettings(device="cpu")))[0].settings.device == "cpu"


@pytest.mark.parametrize("file", ["nvidia0", "nvidiactl", "dxg", "kfd", "dri/renderD128"])
def test_blender_is_asked_wherever_a_gpu_may_be(tmp_path, file):
    (tmp_path / "dri").mkdir()
    (tmp_path / "dri/card0").touch()  # every screen's, also of virtual machines without a GPU
    assert not may_have_gpu("linux", tmp_path)
    assert may_have_gpu("darwin", tmp_path)
    (tmp_path / file).touch()
    assert may_have_gpu("linux", tmp_path)


@pytest.mark.render
def test_blender_finds_this_processor():
    assert [device.kind for device in devices._ask("auto")].count("cpu") == 1
