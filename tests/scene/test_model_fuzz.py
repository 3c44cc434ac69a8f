"""Damaged model files: a scene or one line that says what is wrong, never a traceback, a warning of NumPy's or a hang."""

import copy
import json
import random
import warnings

import gltf_files
import numpy as np
import pytest

from bigtri import Camera, ModelWarning, load_scene, render

# What a value of the JSON is replaced by.
JUNK = (None, True, -1, 0, 1, 7, 2**31 - 1, 2**63, 0.5, 1e300, -1e300, "", "x", "nodes", [], [0], {}, {"a": 0}, "KHR_", [[]])


def everything():
    """One file with most of what the reader knows."""
    file = gltf_files.textured_quad(reference={"extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 1}}})
    primitive = file.json["meshes"][0]["primitives"][0]
    positions = primitive["attributes"]["POSITION"]
    primitive["attributes"]["COLOR_0"] = file.accessor(np.full((4, 3), 200, np.uint8), normalized=True)
    primitive["targets"] = [{"POSITION": positions}]
    file.json["meshes"][0]["weights"] = [0.5]
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": positions}}}
    file.json["nodes"][0] |= {"children": [1], "extensions": instances}
    skin = gltf_files.skin_at_rest()
    joints, weights = np.zeros((4, 4), np.uint8), np.tile(np.float32((1, 0, 0, 0)), (4, 1))
    skinned = file.primitive({"POSITION": gltf_files.QUAD, "JOINTS_0": joints, "WEIGHTS_0": weights}, mode=5, material=0)
    file.add("nodes", mesh=file.add("meshes", primitives=[skinned]), skin=0, rotation=[0, 0, 1, 0], name="skinned")
    inverse = file.accessor(np.tile(np.eye(4, dtype=np.float32), (2, 1, 1)).reshape(2, 16))
    file.add("skins", **{**skin.json["skins"][0], "inverseBindMatrices": inverse, "joints": [0, 1]})
    values, where = file.view(gltf_files.QUAD[:1].tobytes()), file.view(b"\2\0")
    file.json["accessors"][positions]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": where, "componentType": 5123},
        "values": {"bufferView": values},
    }
    file.json["nodes"][1] |= {"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}
    file.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.5})
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {"outerConeAngle": 0.5}}]}}
    file.json["materials"][0] |= {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}, "alphaMode": "MASK"}
    file.json["meshes"][0]["primitives"].append({**primitive, "mode": 2})
    return file


def check(path, draw):
    """Loads a file and draws it, or takes the error that says why not."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", ModelWarning)
        try:
            scene = load_scene(path)
        except ValueError as error:
            text = str(error)
            assert text.startswith(f"bigtri.load_scene: {path}: ") and "\n" not in text and "Error" not in text
            return False
        if draw:
            render(scene, Camera((0, 0, 9), (0, 0, 0)), (8, 8))
        return True


def places(value):
    """(container, key) of everything in the JSON."""
    for key in value if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], dict | list):
            yield from places(value[key])


def test_the_undamaged_file_is_drawn(tmp_path):
    assert check(everything().write(tmp_path / "file.glb"), draw=True)


def test_truncated(tmp_path):
    data = everything().glb()
    cuts = random.Random(0).sample(range(len(data)), 100)
    for cut in cuts:
        (tmp_path / "cut.glb").write_bytes(data[:cut])
        assert not check(tmp_path / "cut.glb", draw=False)


@pytest.mark.parametrize("seed", range(6))
def test_values_of_the_json_replaced(tmp_path, seed):
    chance = random.Random(seed)
    original = json.dumps(everything().json)
    file, drawn = everything(), 0
    for count in range(120):
        file.json = json.loads(original)
        for _ in range(1 + count % 2):
            container, key = chance.choice(list(places(file.json)))
            if isinstance(container, dict) and chance.random() < 0.2:
                del container[key]
            else:
                container[key] = copy.deepcopy(chance.choice(JUNK))
        drawn += check(file.write(tmp_path / "changed.glb"), draw=count % 10 == 0)
    assert 0 < drawn < 120  # some are harmless, some are not


@pytest.mark.parametrize("seed", range(2))
def test_bytes_replaced(tmp_path, seed):
    chance = random.Random(seed)
    data = everything().glb()
    for count in range(120):
        damaged = bytearray(data)
        for _ in range(chance.choice((1, 1, 4, 16))):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        (tmp_path / "damaged.glb").write_bytes(damaged)
        check(tmp_path / "damaged.glb", draw=count % 10 == 0)
