"""Tests of the package `tectum` that need no run: unittest, with the packages of requirements.txt."""

import json
import os
import random
import tempfile
import unittest
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import safetensors.numpy
import xxhash

from tectum import streams
from tectum.checkpoint import Checkpoints, decode, encode, ticks_of
from tectum.crash_store import HEAD, CrashStore, Ring
from tectum.errors import Refused
from tectum.programs import find
from tectum.reports import Spread, Windows
from tectum.state import pack, unpack
from tectum.xxh3 import xxh3_64


class Streams(unittest.TestCase):
    def test_the_hash_of_a_name_is_xxh3(self):
        draw = random.Random(1)
        for length in range(129):
            for seed in (0, 1, 2**32 + 5, 2**63 + 11, draw.getrandbits(64)):
                data = draw.randbytes(length)
                self.assertEqual(xxh3_64(data, seed), xxhash.xxh3_64_intdigest(data, seed), (length, seed))

    def test_a_generator_continues_from_its_state(self):
        source = streams.generator(3, "noise")
        source.normal(size=5)
        state = json.loads(json.dumps(streams.generator_state(source)))
        other = streams.generator(4, "other")
        streams.restore_generator(other, state)
        np.testing.assert_array_equal(source.normal(size=5), other.normal(size=5))


class Hashes(unittest.TestCase):
    def test_the_hash_of_any_content_is_xxh3(self):
        draw = random.Random(2)
        for length in [*range(1100), 2048, 2049, 3 * 1024 + 64, 3 * 1024 + 65, 100_000]:
            data = draw.randbytes(length)
            self.assertEqual(xxh3_64(data), xxhash.xxh3_64_intdigest(data), length)


class CheckpointFiles(unittest.TestCase):
    FACTS = {"format": 1, "role": "plant", "run": "0" * 16, "tick": 7, "sequence": 7}

    def test_a_state_comes_back_and_any_safetensors_reader_reads_the_file(self):
        for size in range(9):
            state = bytes(range(1, size + 1))
            content = encode(self.FACTS, state)
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "7.plant.safetensors"
                file.write_bytes(content)
                self.assertEqual(decode(file), (self.FACTS, state))
            self.assertEqual(safetensors.numpy.load(content)["python.length"], [size])

    def test_every_changed_byte_is_found(self):
        content = encode(self.FACTS, b"a state")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "7.plant.safetensors"
            for at in range(len(content)):
                changed = bytearray(content)
                changed[at] ^= 0x08
                file.write_bytes(changed)
                with self.assertRaises(Refused, msg=at) as caught:
                    decode(file)
                self.assertIn("7.plant.safetensors", str(caught.exception))


class KeptCheckpoints(unittest.TestCase):
    def written(self, keep, folder, ticks):
        manifest = {"keep_checkpoints": keep} if keep else {}
        wire = {"scenario": "1", "schema": "2", "build": "3"}
        checkpoints = Checkpoints(SimpleNamespace(manifest=manifest, folder=folder, id=1, wire=wire), "plant")
        for tick in ticks:
            checkpoints.write(tick, tick, [b"state"])
        return checkpoints.finish()

    def test_the_newest_stay(self):
        ticks = [8, 9, 10, 100, 1000]
        for keep, left in ((0, ticks), (2, [100, 1000]), (9, ticks)):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                (folder / "checkpoints").mkdir()
                others = [folder / "checkpoints" / name for name in ("7.controller.safetensors", "notes.txt")]
                for other in others:
                    other.write_text("")
                self.assertEqual(self.written(keep, folder, ticks), (len(ticks), None))
                self.assertEqual(ticks_of(folder, "plant"), left)
                self.assertTrue(all(other.exists() for other in others), "those of others are left alone")

    def test_a_failure_is_remembered_however_many_follow(self):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "checkpoints").mkdir()
            (folder / "checkpoints" / "5.plant.safetensors").mkdir()
            count, failure = self.written(2, folder, [5, *range(10, 40)])
            self.assertEqual(count, 30)
            self.assertIn("a checkpoint cannot be written", failure)


class States(unittest.TestCase):
    def test_a_state_comes_back_as_it_was(self):
        state = {
            "array": np.arange(6, dtype=np.float32).reshape(2, 3),
            "empty": np.zeros((0, 4)),
            "bytes": b"\0\1",
            "deep": {"list": [1, 2.5, "text", None, True], "number": np.float64(0.1)},
        }
        back = unpack(b"".join(pack(state)))
        np.testing.assert_array_equal(back["array"], state["array"])
        self.assertEqual((back["array"].dtype, back["empty"].shape), (np.float32, (0, 4)))
        self.assertEqual((back["bytes"], back["deep"]["list"]), (b"\0\1", [1, 2.5, "text", None, True]))
        self.assertEqual(float(back["deep"]["number"]), 0.1)

    def test_what_a_state_cannot_hold_is_named(self):
        with self.assertRaises(Refused) as caught:
            pack({"net": {"layer": object()}})
        self.assertIn("state()['net']['layer'] is a object", str(caught.exception))


class CrashStores(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = Path(self.folder.name)
        self.addCleanup(self.folder.cleanup)

    def test_the_newest_whole_state_is_found_again(self):
        store = CrashStore(self.root, "x")
        self.assertIsNone(store.newest())
        for number, size in [(1, 10), (2, 20), (3, 5000), (4, 7)]:
            store.store(number, [bytes([number]) * size])
            self.assertEqual(CrashStore(self.root, "x").newest(), (number, bytes([number]) * size))

    def test_a_store_goes_on_after_its_process_died(self):
        for number in range(1, 6):
            CrashStore(self.root, "x").store(number, [b"state", bytes([number])])
        self.assertEqual(CrashStore(self.root, "x").newest(), (5, b"state\5"))

    def test_a_torn_state_is_absent_and_the_one_before_it_is_there(self):
        store = CrashStore(self.root, "x")
        store.store(1, [b"first"])
        store.store(2, [b"second"])
        path = self.root / "x.state-1"
        whole = path.read_bytes()
        self.assertIn(b"second", whole)
        for at in range(HEAD.size + len(b"second")):
            torn = bytearray(whole)
            torn[at] ^= 0x10
            path.write_bytes(torn)
            self.assertEqual(CrashStore(self.root, "x").newest(), (1, b"first"), at)

    def test_a_ring_holds_the_newest_entries(self):
        for number in range(10):  # opened anew each time, as after ten deaths
            Ring(self.root / "ring", 4, 3).append(number, [bytes([number]) * 3])
        ring = Ring(self.root / "ring", 4, 3)
        self.assertEqual([n for n in range(12) if ring.entry(n)], [6, 7, 8, 9])
        self.assertEqual(ring.entry(7), b"\7\7\7")


class Reports(unittest.TestCase):
    def test_percentiles(self):
        spread = Spread()
        for us in range(1, 101):
            spread.add(us * 1000)
        found = spread.percentiles()
        self.assertEqual((found["count"], found["p50"], found["p99"], found["max"]), (100, 50.0, 99.0, 100.0))

    def test_windows_hold_every_tick_once(self):
        windows = Windows(1000, 0)
        for tick in range(1000):
            windows.add(tick, -1.0, 2.0, tick % 10 == 9)
        windows.close()
        self.assertEqual(sum(window["ticks"] for window in windows.windows), 1000)
        self.assertEqual(sum(window["ends"] for window in windows.windows), 100)
        self.assertTrue(all(window["loss"] == 1.0 for window in windows.windows))


class Programs(unittest.TestCase):
    def test_a_missing_program_says_how_to_get_it(self):
        kept = dict(os.environ)
        self.addCleanup(lambda: (os.environ.clear(), os.environ.update(kept)))
        with tempfile.TemporaryDirectory() as empty:
            os.environ["TECTUM_BIN"] = empty
            with self.assertRaises(Refused) as caught:
                find("tectum")
            self.assertIn(f"TECTUM_BIN is {empty}, and there is no program tectum there", str(caught.exception))
            (Path(empty) / "tectum").touch()
            self.assertEqual(find("tectum"), (Path(empty) / "tectum").resolve())


if __name__ == "__main__":
    unittest.main()
