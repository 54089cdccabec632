"""What is left when a writer is killed: a plan that is whole, no mixture, and others' files."""

from __future__ import annotations

import subprocess
import sys

import pytest

COMMON = '''
import os, shutil, signal, sys
from pathlib import Path
from hitchopt.storage.files import replace_files

OWNED = ("plan.npz", "setpoints.csv", "certificate.json", "diagnosis.json")
PLAN, SEAL = OWNED[:3], "certificate.json"
directory = Path(sys.argv[1]) / "some dir"

def files(tag):
    """The files of one save, each telling which: a plan for odd tags, a refusal for even ones."""
    names = PLAN if tag % 2 else OWNED[3:]
    return {name: f"{tag} {name}\\n" * 50 for name in names}

def writer(text):
    def write(path):
        path.write_text(text)
        os.getppid()  # one more place to be killed at: the file is written, not synced
    return write

def save(tag):
    writers = {name: writer(text) for name, text in files(tag).items()}
    replace_files(directory, writers, OWNED, SEAL, "remove" if tag % 2 else "keep")

def put(place, contents):
    place.mkdir(parents=True, exist_ok=True)
    for name, text in contents.items():
        (place / name).write_text(text)

def prepare(now, last):
    """The directory after save(now); ``last`` is the plan that a refusal keeps, or 0."""
    put(directory, files(now))
    put(directory / "sub", {"notes.txt": "mine"})
    if last:
        put(directory / "previous", files(last))
    (directory / "link").symlink_to("sub/notes.txt")

def check_others(final):
    assert (directory / "sub" / "notes.txt").read_text() == "mine"
    assert (directory / "link").is_symlink()
    if final:
        names = {p.name for p in directory.iterdir()} - {*OWNED, "previous"}
        assert names == {"sub", "link"}, names
        assert [p.name for p in directory.parent.iterdir()] == [directory.name]

def have(place=directory):
    if not place.is_dir():
        return {}
    return {n: (place / n).read_text() for n in OWNED if (place / n).exists()}

def forked(work):
    """Run ``work`` in a child; return whether it came to its end."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            import traceback
            traceback.print_exc()
            os._exit(3)
    status = os.waitpid(child, 0)[1]
    assert status in (0, signal.SIGKILL), status
    return status == 0

os.fsync = lambda descriptor: None  # no power is cut here, and it takes most of the time
'''

STEPS = '''
def killed_at(count):
    """Let the process be killed at its count-th step that the file system sees."""
    left = [count]
    def dying(function):
        def call(*args, **kwargs):
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left[0] -= 1
            return function(*args, **kwargs)
        return call
    for name in "mkdir rename replace link symlink unlink rmdir open fsync getppid".split():
        setattr(os, name, dying(getattr(os, name)))

def run(count, tag):
    killed_at(count)
    save(tag)

instants = 0
# What is there, the plan that it keeps, what is saved, what is saved after that.
for now, last, new, after in (
    (1, 0, 3, 5), (1, 0, 2, 4), (2, 1, 3, 4), (2, 1, 4, 6), (3, 1, 5, 6), (3, 1, 4, 5), (0, 0, 1, 2)
):
    seen = set()
    for count in range(1000):
        if now:
            prepare(now, last)
        done = forked(lambda: run(count, new))
        instants += 1
        found, kept = have(), have(directory / "previous")
        plans = [files(tag) for tag in (now, last, new) if tag % 2]
        if SEAL in found or "diagnosis.json" in found:  # no mixture
            assert found in (files(now), files(new)), (count, found.keys())
        if now:  # nothing is lost
            plan = {name: text for name, text in found.items() if name in PLAN}
            assert plan in plans or kept in plans, (now, new, count)
            check_others(final=done)
        else:
            assert found == (files(new) if directory.exists() else {})
        seen.add((found == (files(now) if now else {}), found == files(new)))
        whole = found if SEAL in found else kept
        assert forked(lambda: save(after)) and have() == files(after)
        assert have(directory / "previous") == ({} if after % 2 else whole), (now, new, count)
        if now:
            check_others(final=True)
        shutil.rmtree(directory.parent)
        directory.parent.mkdir()
        if done:
            break
    assert {(True, False), (False, True)} <= seen, (now, new, seen)
assert instants > 200, instants
print("ok")
'''

TOGETHER = """
prepare(1, 0)
children = []
for process in range(4):
    child = os.fork()
    if child == 0:
        for i in range(15):
            save(100 * process + i)
        os._exit(0)
    children.append(child)
assert [os.waitpid(child, 0)[1] for child in children] == [0] * 4
found = have()
assert found == files(int(next(iter(found.values())).split()[0]))
check_others(final=True)
print("ok")
"""


@pytest.mark.slow
@pytest.mark.parametrize("script", [STEPS, TOGETHER], ids=["steps", "four"])
def test_killed_or_crowded_writers_lose_and_mix_nothing(script: str, tmp_path: object) -> None:
    run = subprocess.run(
        [sys.executable, "-c", COMMON + script, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (run.stdout, run.returncode) == ("ok\n", 0), run.stderr
