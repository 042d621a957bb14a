"""Readers in a process of their own: what they return comes back, and whatever ends them is one sentence."""

import os
import sys

import numpy as np
import pytest

import hurtful_readers
from airtact.files.apart import read_apart
from faults import raises_code

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows has no limits of this kind"
)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "some.bin"
    path.write_bytes(b"abc")
    return path


def test_arrays_come_back_from_another_process(file):
    found = read_apart(hurtful_readers.talks, file)
    assert bytes(found["bytes"]) == b"abc"
    assert int(found["pid"]) != os.getpid()


def test_packages_that_a_reader_does_not_need_are_not_imported(file):
    found = read_apart(hurtful_readers.imports, file, without=("wave", "a_package_that_nobody_has"))
    assert found["imported"].tolist() == ["decimal"]


def test_a_fault_keeps_its_code(file):
    with raises_code("file_unreadable", "some.bin has 1 fault."):
        read_apart(hurtful_readers.rejects, file)


def test_a_reader_that_hangs_is_ended(file):
    with raises_code("file_too_large", "some.bin", "1 s"):
        read_apart(hurtful_readers.hangs, file, seconds=1)


def test_a_reader_that_eats_memory_is_ended(file):
    with raises_code("too_little_memory", "some.bin"):
        read_apart(hurtful_readers.eats, file, memory=10**9)


def test_a_reader_that_crashes_is_a_fault_of_the_file(file):
    with raises_code("file_unreadable", "some.bin", "-11"):
        read_apart(hurtful_readers.crashes, file)


def test_where_no_process_can_be_started_this_one_reads(file, monkeypatch):
    monkeypatch.setattr(sys, "executable", "")
    assert int(read_apart(hurtful_readers.talks, file)["pid"]) == os.getpid()
    monkeypatch.setattr(sys, "executable", str(file))
    np.testing.assert_equal(int(read_apart(hurtful_readers.talks, file)["pid"]), os.getpid())
