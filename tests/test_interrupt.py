"""Ctrl-C stops a long render and a long capture; the process and its interpreter live on."""

import signal
import subprocess
import sys
import time

import pytest

# minutes of work: the test only ends in time if the work is abandoned
WORK = {
    "render": "oitlab.render_many(scene, [('lwboit', {'bins': n}) for n in range(200, 300)])",
    "capture": "[oitlab.capture(scene) for _ in range(1000)]",
    "sensitivity": "oitlab.order_sensitivity(oitlab.scenes.smoke(), 'alpha_compositing', n=4000)",
}
PROGRAM = """
import oitlab
scene = oitlab.scenes.smoke(width=960, height=540)
print("ready", flush=True)
try:
    {work}
except KeyboardInterrupt:
    print("stopped", oitlab.render(scene.replace(width=8, height=8), "wboit").color.shape)
"""


@pytest.mark.parametrize("work", WORK)
def test_ctrl_c_stops(work: str) -> None:
    program = [sys.executable, "-c", PROGRAM.format(work=WORK[work])]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert output == "stopped (8, 8, 3)\n"
    assert process.returncode == 0
