"""``python -m tests.broken_run``: the smoke study, killed in three stages and started again, ends
as an unbroken one.

Takes about two smoke runs. Works in build/smoke, where it replaces what is there.
"""

import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path("build/smoke")
STAGES = ("meshes", "episodes", "perception", "objects", "dynamics")
POLL_S = 0.2
# What lies in .work while a stage is in the middle of its work.
MIDDLES = (
    "episodes/pushing-train/*/traj_000004",
    "perception/*/progress/checkpoint.safetensors",
    "dynamics/pushing-oes/*/progress/checkpoint.safetensors",
)


def main() -> None:
    """Print what was compared; exit 1 where a byte differs."""
    subprocess.run(["make", "profile", "PROFILE=smoke"], check=True)
    whole = run_with_kills(())
    broken = run_with_kills(MIDDLES)
    different = sorted(name for name in whole | broken if whole.get(name) != broken.get(name))
    print(
        f"{len(whole)} files of {', '.join(STAGES)}; "
        f"different after {len(MIDDLES)} kills: {len(different)}"
    )
    sys.exit("\n".join(different) or None)


def run_with_kills(middles: tuple[str, ...]) -> dict[str, str]:
    """Run the stages from nothing, killed once for each pattern as soon as it matches. SHA-256 of
    every output file.
    """
    for name in ("datasets", ".work"):
        shutil.rmtree(HERE / name, ignore_errors=True)
    (HERE / "dvc.lock").unlink(missing_ok=True)
    for pattern in middles:
        process = start()
        while not list((HERE / ".work").glob(pattern)):
            if process.poll() is not None:
                sys.exit(f"the run ended (code {process.returncode}) before {pattern} was there")
            time.sleep(POLL_S)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        print(f"killed at {pattern}", flush=True)
    if start().wait():
        sys.exit("the run failed")
    files = [
        path
        for stage in STAGES
        for path in sorted((HERE / "datasets" / stage).rglob("*"))
        if path.is_file()
    ]
    return {
        str(path.relative_to(HERE)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
    }


def start() -> "subprocess.Popen[bytes]":
    """The study up to the dynamics, as the Makefile starts it, but never from DVC's cache of
    earlier runs.
    """
    bin_folder = Path(sys.executable).parent.absolute()
    env = os.environ | {"PATH": f"{bin_folder}:{os.environ['PATH']}", "DVC_NO_ANALYTICS": "1"}
    command = [str(bin_folder / "dvc"), "repro", "--no-run-cache", "dynamics"]
    return subprocess.Popen(command, cwd=HERE, env=env, start_new_session=True)


if __name__ == "__main__":
    main()
