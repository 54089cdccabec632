"""What is left when the writer is killed: everything old or everything new, and others' files."""

from __future__ import annotations

import subprocess
import sys

import pytest

COMMON = '''
import os, random, signal, sys, time
from pathlib import Path
import hitchopt.storage.atomic as atomic
import hitchopt.storage.directory_swap as swap

OWNED = ("plan.npz", "setpoints.csv", "certificate.json", "diagnosis.json")
SEAL = "certificate.json"
directory = Path(sys.argv[1]) / "some dir"

def sets(tag):
    """The files of one save, each telling which."""
    names = OWNED[:3] if tag % 2 else OWNED[3:]
    return {name: f"{tag} {name}\\n" * 50 for name in names}

def writer(text):
    def write(path):
        with path.open("w") as file:
            for line in text.splitlines(True):
                file.write(line)
            file.flush()
            os.getppid()  # one more place to be killed at: the file is written, not synced
    return write

def save(tag):
    """A plan for odd tags; a refusal, which keeps the last plan, for even ones."""
    writers = {n: writer(t) for n, t in sets(tag).items()}
    atomic.replace_files(directory, writers, OWNED, SEAL, "remove" if tag % 2 else "keep")

def kept(tag):
    """What previous/ holds after save(tag) that follows save(tag - 1)."""
    return {} if tag % 2 else sets(tag - 1)

def prepare(tag):
    directory.mkdir()
    for name, text in sets(tag).items():
        (directory / name).write_text(text)
    for name, text in kept(tag).items():
        (directory / "previous").mkdir(exist_ok=True)
        (directory / "previous" / name).write_text(text)
    (directory / "notes.txt").write_text("mine")
    (directory / "sub" / "deep").mkdir(parents=True)
    (directory / "sub" / "deep" / "keep.txt").write_text("keep")
    (directory / "empty").mkdir()
    (directory / "link").symlink_to("notes.txt")
    (directory / ".hidden").write_text("hidden")

def check_others(final):
    assert (directory / "notes.txt").read_text() == "mine"
    assert (directory / "sub" / "deep" / "keep.txt").read_text() == "keep"
    assert list((directory / "empty").iterdir()) == []
    assert (directory / "link").read_text() == "mine"
    assert (directory / ".hidden").read_text() == "hidden"
    if final:
        assert (directory / "link").is_symlink() and not (directory / "sub").is_symlink()
        names = {p.name for p in directory.iterdir()} - {*OWNED, "previous"}
        assert (directory / "previous").exists() == bool(previous())
        assert names == {"notes.txt", "sub", "empty", "link", ".hidden"}, names
        assert [p.name for p in directory.parent.iterdir()] == [directory.name]

def owned():
    return {n: (directory / n).read_text() for n in OWNED if (directory / n).exists()}

def previous():
    place = directory / "previous"
    return {p.name: p.read_text() for p in place.iterdir()} if place.exists() else {}

def clean():
    import shutil
    shutil.rmtree(directory.parent)
    directory.parent.mkdir()

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
'''

INJECTED = '''
os.fsync = lambda descriptor: None  # no power is cut here, and it takes most of the time

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
    names = "mkdir rename replace link symlink unlink rmdir open fsync chmod getppid"
    for name in names.split():
        setattr(os, name, dying(getattr(os, name)))
    swap.exchange = dying(swap.exchange)

def unavailable(*_):
    raise OSError(38, "no such call")

def run(mode, count, tag):
    killed_at(count)
    if mode == "one by one":
        swap.exchange = unavailable
    save(tag)

for mode in ("exchange", "one by one", "absent"):
    states = set()
    for tag in (2, 3):
        for count in range(1000):
            if mode != "absent":
                prepare(tag - 1)
            done = forked(lambda: run(mode, count, tag))
            have = owned()
            before = {} if mode == "absent" else sets(tag - 1)
            plans = [sets(tag - 1 - tag % 2), sets(tag - 1 + tag % 2)]  # before and after
            if mode != "absent":  # a plan is whole at any time, in the directory or kept
                plan = {n: t for n, t in have.items() if n in OWNED[:3]}
                assert plan in plans or previous() in plans, (mode, count)
            if mode == "exchange":
                assert previous() == (kept(tag - 1) if have == before else kept(tag))
            if mode == "one by one":  # whole wherever there is a seal or a diagnosis
                assert SEAL not in have or have in (before, sets(tag)), (count, have.keys())
            else:
                assert have in (before, sets(tag)), (mode, count, have.keys())
                assert directory.exists() == (mode != "absent" or bool(have))
            states.add((tag, have == before, have == sets(tag)))
            if mode != "absent":
                check_others(final=done)
            again = forked(lambda: save(tag + 1))  # cleans up after the killed one
            assert again and owned() == sets(tag + 1)
            if mode != "absent":
                last = tag if have == sets(tag) else tag - 2
                assert previous() == ({} if tag % 2 == 0 else sets(last)), (mode, count)
            if mode != "absent":
                check_others(final=True)
            else:
                assert [p.name for p in directory.parent.iterdir()] == [directory.name]
            clean()
            if done:
                break
        assert count > 12, (mode, count)
        assert (tag, False, True) in states and (tag, True, False) in states
print("ok")
'''

RANDOM = """
os.fsync = lambda descriptor: None  # the more often it is killed in between
chance = random.Random(11)
prepare(1)
whole = {}
round = 0
while round < 60 or len(whole) <= 20:  # on a busy machine the killed one may not get far
    first = 2 * round
    round += 1
    child = os.fork()
    if child == 0:
        for i in range(100000):
            save(first + i)
    time.sleep(chance.uniform(0.0, 0.02))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    have = owned()
    tag = int(next(iter(have.values())).split()[0])
    assert have == sets(tag), have.keys()
    check_others(final=False)
    whole[tag] = True
save(7)
check_others(final=True)
print("ok")
"""

TOGETHER = """
prepare(1)
children = []
for process in range(4):
    child = os.fork()
    if child == 0:
        for i in range(15):
            save(100 * process + i)
        os._exit(0)
    children.append(child)
assert [os.waitpid(child, 0)[1] for child in children] == [0] * 4
have = owned()
tag = int(next(iter(have.values())).split()[0])
assert have == sets(tag)
check_others(final=True)
print("ok")
"""


@pytest.mark.slow
@pytest.mark.parametrize("script", [INJECTED, RANDOM, TOGETHER], ids=["steps", "random", "four"])
def test_killed_or_crowded_writers_leave_one_whole_set(script: str, tmp_path: object) -> None:
    run = subprocess.run(
        [sys.executable, "-c", COMMON + script, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert (run.stdout, run.returncode) == ("ok\n", 0), run.stderr
