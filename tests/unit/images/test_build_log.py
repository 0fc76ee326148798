from __future__ import annotations

import pytest

from fleet.images.build_log import TAIL, BuildLog

# Docker 20.10.24, `docker build` with BuildKit into a pipe.
OLD = """\
#1 [internal] load build definition from Dockerfile
#1 sha256:818725521fe29754cb0a41610230ebbda53ba6dc3e201bfd5330c3e658de23f7
#1 transferring dockerfile: 243B done
#1 DONE 0.0s

#4 [1/3] FROM docker.io/library/fleet-debian:bookworm-amd64
#4 sha256:bb5850bd0ec1555b5e7ad8d091960c3f4e5f46550be8da987a3ef8b3c3510689
#4 CACHED

#5 [2/3] WORKDIR /app
#5 CACHED

#7 [3/3] COPY . /app
#7 DONE 0.0s

#8 exporting to image
#8 writing image sha256:e7831442d639f44d4d92327627c6f0bc10321fa308c420abe52141b0c3a59457 done
#8 DONE 0.0s
"""

# The same, with a step that fails while another one runs.
FAILED = """\
#5 [stage-1 1/2] RUN sleep 9
#6 [build 2/2] RUN cat /nope
#5 0.211 waiting
#6 0.312 \x1b[31mcat: /nope\x1b[0m: No such file or directory
#6 ERROR: executor failed running [/bin/sh -c cat /nope]: exit code: 1
#5 CANCELED
------
 > [build 2/2] RUN cat /nope:
#6 0.312 cat: /nope: No such file or directory
------
executor failed running [/bin/sh -c cat /nope]: exit code: 1
"""


def read(text: str) -> tuple[BuildLog, list[str]]:
    log = BuildLog()
    steps = [log.feed(line) for line in text.splitlines()]
    return log, [step.title for step in steps if step]


def test_steps_are_counted_with_those_of_the_cache() -> None:
    """Without BuildKit's own, which nobody wrote into a Dockerfile."""
    log, working = read(OLD)
    assert log.summary() == "3 steps, 2 cached"
    assert working == []
    assert read(OLD.replace("#7 DONE 0.0s", "#7 CACHED"))[0].summary() == "3 steps, all cached"
    assert read("")[0].summary() == "0 steps, 0 cached"


def test_the_step_that_failed_is_named_with_its_own_last_words() -> None:
    """Not those of the step beside it, and without colours."""
    log, working = read(FAILED)
    assert working == ["[stage-1 1/2] RUN sleep 9", "[build 2/2] RUN cat /nope"]
    title, lines, cure = log.failure()
    assert title == "[build 2/2] RUN cat /nope"
    assert lines == ("cat: /nope: No such file or directory",)
    assert cure == ""


def test_a_program_that_said_nothing_has_buildkit_s_words() -> None:
    """The exit code is better than no line; docker 20.10 and buildx 0.13."""
    for said in (
        "executor failed running [/bin/sh -c x]: exit code: 1",
        'process "/bin/sh -c x" did not exit code: 1',
    ):
        assert read(f"#6 [2/2] RUN x\n#6 ERROR: {said}")[0].failure()[1] == (said,)


def test_a_failure_before_the_first_step_has_the_last_lines() -> None:
    """A Dockerfile that cannot be read; BuildKit's own steps can fail, too."""
    log, _ = read("failed to solve: dockerfile parse error line 1: unknown instruction: FRM\n\n")
    assert log.failure() == (
        "",
        ("failed to solve: dockerfile parse error line 1: unknown instruction: FRM",),
        "",
    )
    log, _ = read("#3 [internal] load metadata for docker.io/library/x:latest\n#3 ERROR: x: no such host\n")
    assert log.failure()[1:] == (
        ("x: no such host",),
        "see whether this computer reaches the registry or the server of that name",
    )


@pytest.mark.parametrize(
    ("said", "cure"),
    [
        ("exec /bin/sh: exec format error", "qemu-user-static"),
        ("write /x: no space left on device", "docker system df"),
        ("pull access denied, repository does not exist", "docker login"),
        ('failed to compute cache key: "/packages" not found: not found', ".dockerignore"),
        ("make: *** [all] Error 2", ""),
    ],
)
def test_words_with_a_known_cure(said: str, cure: str) -> None:
    """Those of BuildKit and of programs in the build."""
    log, _ = read(f"#6 [2/2] RUN make\n#6 0.1 {said}\n#6 ERROR: exit code: 1")
    assert (cure in log.failure()[2]) if cure else log.failure()[2] == ""


def test_a_long_output_keeps_its_end() -> None:
    """A compiler may print a gigabyte."""
    log, _ = read(
        "#6 [2/2] RUN make\n" + "".join(f"#6 {n}.0 line {n}\n" for n in range(1000)) + "#6 ERROR: 1"
    )
    assert log.failure()[1] == (*(f"line {n}" for n in range(1000 - TAIL + 1, 1000)), "1")
