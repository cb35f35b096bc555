"""Faults that an export may have, planted in its files: how the lines of each format are read and written again.

| fault | what it is |
|---|---|
| mirrored | x of all points changes its sign, or in pixels counts from the right |
| shifted | all points move 0.3 m or 4 px to the right |
| swapped | two lines exchange their points; where lines have no name or number, two frames do |
| dropped | the first line is missing |
| reordered | the points of a line come in another order; in OpenDRIVE, two lanes |
"""

import json

import numpy as np

from tests.formats.planting import other

FAULTS = ("mirrored", "shifted", "swapped", "dropped", "reordered")


def json_lines(pattern, key):
    """Frames that are lines of JSON, with lines of points under a key."""

    def plant(out, fault):
        path = next(out.glob(pattern))
        documents = [json.loads(line) for line in path.read_text().splitlines()]
        other = documents[1][key] if len(documents) > 1 else None
        documents[0][key] = moved(documents[0][key], fault, other)
        if fault == "dropped":
            documents[0].get(f"{key}_visibility", [None]).pop(0)
        path.write_text("".join(json.dumps(document) + "\n" for document in documents))

    return plant


def moved(lines, fault, other=None, *, x=0, right=1, step=0.3, width=0.0):
    """The lines with a fault; their points are (x, ...), x grows to the right or to the left."""
    arrays = [np.array(line, dtype=float) for line in lines]
    if fault == "mirrored":
        for array in arrays:
            array[:, x] = width - array[:, x]
    elif fault == "shifted":
        for array in arrays:
            array[:, x] += right * step
    elif fault == "swapped":
        arrays[0], arrays[1] = arrays[1], arrays[0]
    elif fault == "dropped":
        del arrays[0]
    else:
        arrays[0] = arrays[0][::-1]
    return [array.tolist() for array in arrays]


def of(pattern):
    """Makes what changes a document a fault of the first file of a pattern."""

    def plants(change):
        return lambda out, fault: other(pattern, lambda found: change(found, fault))(out)

    return plants


@of("lane3d_1000/validation/seg*/*.json")
def openlane(document, fault):
    lines = document["lane_lines"]
    if fault == "swapped":
        left, right = (next(line for line in lines if line["attribute"] == place) for place in (2, 3))
        for key in ("xyz", "uv", "visibility"):
            left[key], right[key] = right[key], left[key]
    elif fault == "dropped":
        del lines[0]
    else:
        points = moved([np.transpose(line["xyz"]) for line in lines], fault, x=1, right=-1)
        for line, moved_points in zip(lines, points, strict=True):
            line["xyz"] = np.transpose(moved_points).tolist()


def once(out, fault):
    paths = sorted(out.glob("ONCE_3DLanes/test/*/cam01/*.json"))
    documents = [json.loads(path.read_text()) for path in paths]
    if fault == "swapped":
        documents[0]["lanes"], documents[1]["lanes"] = documents[1]["lanes"], documents[0]["lanes"]
    else:
        documents[0]["lanes"] = moved(documents[0]["lanes"], fault)
    for path, document in zip(paths, documents, strict=True):
        path.write_text(json.dumps(document))


def tusimple(out, fault):
    path = out / "test_label.json"
    documents = [json.loads(line) for line in path.read_text().splitlines()]
    lanes = np.array(documents[0]["lanes"])
    there = lanes >= 0
    if fault == "mirrored":
        lanes[there] = 1280 - lanes[there]
    elif fault == "shifted":
        lanes[there] += 4
    elif fault == "swapped":
        lanes[:2] = lanes[1::-1]
    elif fault == "dropped":
        lanes = lanes[1:]
    else:
        lanes[0] = lanes[0, ::-1]
    documents[0]["lanes"] = lanes.tolist()
    path.write_text("".join(json.dumps(document) + "\n" for document in documents))


def texts(pattern, width):
    """Files with x and y of a line's points in turn."""

    def plant(out, fault):
        path = sorted(out.glob(pattern))[0]
        lines = [np.array(text.split(), dtype=float).reshape(-1, 2) for text in path.read_text().splitlines()]
        lines = moved(lines, fault, step=4.0, width=width)
        path.write_text("".join(" ".join(str(n) for point in line for n in point) + "\n" for line in lines))
        told = path.with_name(path.name.replace(".lines.txt", ".json"))
        if fault == "dropped" and told.exists():
            told.write_text(json.dumps(json.loads(told.read_text())[1:]))

    return plant


@of("valid/labels/*.json")
def curvelanes(document, fault):
    lines = [[(float(p["x"]), float(p["y"])) for p in line] for line in document["Lines"]]
    lines = moved(lines, fault, step=4.0, width=2560.0)
    return {"Lines": [[{"x": str(x), "y": str(y)} for x, y in line] for line in lines]}


@of("OpenLane-V2/test/*/info/*[0-9].json")
def openlane_v2(document, fault):
    found = document["annotation"]
    lanes = found["lane_centerline"]
    points = moved([lane["points"] for lane in lanes], fault, x=1, right=-1)
    if fault == "dropped":
        del lanes[0]
        found["topology_lclc"] = [row[1:] for row in found["topology_lclc"][1:]]
        del found["topology_lcte"][0]
    for lane, line in zip(lanes, points, strict=True):
        lane["points"] = line


@of("test/*/map/log_map_archive_*.json")
def argoverse2(document, fault):
    lanes = list(document["lane_segments"].values())
    for side in ("left_lane_boundary", "right_lane_boundary"):
        lines = [[[p[axis] for axis in "xyz"] for p in lane[side]] for lane in lanes]
        for lane, line in zip(lanes, lines if fault == "dropped" else moved(lines, fault), strict=True):
            lane[side] = [dict(zip("xyz", point, strict=True)) for point in line]
    if fault == "dropped":
        first = min(document["lane_segments"])[:-3]
        document["lane_segments"] = {i: lane for i, lane in document["lane_segments"].items() if i[:-3] != first}


@of("maps/expansion/singapore-hollandvillage.json")
def nuscenes(document, fault):
    paths = document["arcline_path_3"]
    flipped = {"LSL": "RSR", "RSR": "LSL"}
    if fault == "swapped":
        one, other = list(paths)[:2]
        paths[one], paths[other] = paths[other], paths[one]
    elif fault == "dropped":
        del paths[next(iter(paths))]
    else:
        for name, arcs in paths.items():
            for arc in arcs:
                (x, y, yaw), (x1, y1, yaw1) = arc["start_pose"], arc["end_pose"]
                if fault == "shifted":
                    arc["start_pose"] = [x + 0.3, y, yaw]
                elif fault == "mirrored":
                    arc |= {"start_pose": [-x, y, np.pi - yaw], "shape": flipped[arc["shape"]]}
                else:
                    arc |= {"start_pose": [x1, y1, yaw1 + np.pi], "shape": flipped[arc["shape"]]}
            paths[name] = arcs[::-1] if fault == "reordered" else arcs


@of("test/*.xodr")
def opendrive(root, fault):
    lanes = [lane for lane in root.iter("lane") if lane.get("type") == "driving"]
    for geometry in root.iter("geometry") if fault in ("mirrored", "shifted") else ():
        x, heading = float(geometry.get("x")), float(geometry.get("hdg"))
        geometry.set("x", str(x + 0.3 if fault == "shifted" else -x))
        if fault == "mirrored":
            geometry.set("hdg", str(np.pi - heading))
            for key in ("cV", "dV"):
                geometry[0].set(key, str(-float(geometry[0].get(key))))
    if fault == "swapped":
        first, second = (lane.find("userData") for lane in lanes[:2])
        one, other = first.get("value"), second.get("value")
        first.set("value", other)
        second.set("value", one)
    elif fault == "dropped":
        outermost = max(lanes, key=lambda lane: abs(int(lane.get("id"))))
        outermost.set("type", "none")
    elif fault == "reordered":
        one, other = lanes[0].get("id"), lanes[1].get("id")
        lanes[0].set("id", other)
        lanes[1].set("id", one)


@of("test/*.osm")
def lanelet2(root, fault):
    if fault in ("mirrored", "shifted"):
        for tag in root.iterfind("node/tag[@k='local_x']"):
            tag.set("v", str(float(tag.get("v")) + 0.3 if fault == "shifted" else -float(tag.get("v"))))
    names = list(root.iterfind("relation/tag[@k='synth3dlanes.segment']"))
    lanes = {name.get("v"): name for name in names}
    if fault == "swapped":
        one, other = list(lanes)[:2]
        for name in names:
            name.set("v", {one: other, other: one}.get(name.get("v"), name.get("v")))
    elif fault == "dropped":
        for relation in root.findall("relation"):
            if relation.find(f"tag[@v='{next(iter(lanes))}']") is not None:
                root.remove(relation)
    elif fault == "reordered":
        bound = root.find("relation/member[@role='left']").get("ref")
        nodes = root.findall(f"way[@id='{bound}']/nd")
        for node, ref in zip(nodes[1:-1], [node.get("ref") for node in nodes[-2:0:-1]], strict=True):
            node.set("ref", ref)


@of("annotations/instances_test.json")
def coco(document, fault):
    image = document["images"][0]["id"]
    things = [thing for thing in document["annotations"] if thing["image_id"] == image and "lane" in thing]
    if fault == "swapped":
        one, other = things[:2]
        one["segmentation"], other["segmentation"] = other["segmentation"], one["segmentation"]
    elif fault == "dropped":
        document["annotations"].remove(things[0])
    elif fault == "reordered":
        runs = things[0]["segmentation"]["counts"]
        runs[1], runs[3] = runs[3] + 1, max(runs[1] - 1, 0)
        runs[0], runs[2] = runs[2], runs[0]
    else:
        for thing in things:
            runs = thing["segmentation"]
            height, width = runs["size"]
            flat = np.repeat(np.arange(len(runs["counts"])) % 2, runs["counts"])
            mask = flat.reshape(height, width, order="F")
            mask = mask[:, ::-1] if fault == "mirrored" else np.roll(mask, 4, axis=1)
            flat = mask.ravel(order="F")
            ends = [0, *(np.flatnonzero(np.diff(flat)) + 1).tolist(), len(flat)]
            runs["counts"] = ([0] if flat[0] else []) + np.diff(ends).tolist()


def yolo(out, fault):
    paths = sorted(out.glob("labels/test-*.txt"))
    texts = [path.read_text() for path in paths]
    rows = [line.split() for line in texts[0].splitlines()]
    objects = [(row[0], np.array(row[1:], dtype=float).reshape(-1, 2)) for row in rows]
    if fault == "mirrored":
        objects = [(name, np.column_stack([1 - corners[:, 0], corners[:, 1]])) for name, corners in objects]
    elif fault == "shifted":
        objects = [(name, np.clip(corners + np.array([4 / 480, 0]), 0, 1)) for name, corners in objects]
    elif fault == "dropped":
        objects = objects[1:]
    elif fault == "reordered":
        long = max(range(len(objects)), key=lambda i: len(objects[i][1]))
        corners = objects[long][1]
        half = len(corners) // 2 // 2 * 2
        objects[long] = (objects[long][0], np.concatenate([corners[half:][::-1], corners[:half]]))
    text = "".join(f"{name} {' '.join(f'{n:.6f}' for n in corners.ravel())}\n" for name, corners in objects)
    paths[0].write_text(texts[1] if fault == "swapped" else text)
    if fault == "swapped":
        paths[1].write_text(texts[0])


PLANTED = {
    "apollo": json_lines("data_splits/standard/test.json", "laneLines"),
    "openlane": openlane,
    "once": once,
    "tusimple": tusimple,
    "culane": texts("driver_*/*.MP4/*.lines.txt", 1640.0),
    "curvelanes": curvelanes,
    "openlane_v2": openlane_v2,
    "argoverse2": argoverse2,
    "nuscenes": nuscenes,
    "opendrive": opendrive,
    "lanelet2": lanelet2,
    "coco": coco,
    "masks": texts("lines/test-*.lines.txt", 480.0),
    "yolo": yolo,
}
