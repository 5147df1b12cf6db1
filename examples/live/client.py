"""Client of `boresight serve --tcp PORT` with Python's standard library alone: python client.py 9042

Gives attitudes in lockstep and prints what the star tracker makes of them. Replace `attitude_at` by your simulator.
"""

import json
import math
import socket
import sys


class Camera:
    """A star camera whose attitude this program decides."""

    def __init__(self, port, host="127.0.0.1", token=""):
        self.socket = socket.create_connection((host, port), timeout=60)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.lines = self.socket.makefile("rb")
        self.welcome = self.ask("welcome", type="hello", protocol=1, token=token)
        self.ask("reply", type="subscribe", channels=["solution"], frame_format="none")
        self.ask("reply", type="command", name="source", attitude="external", lockstep=True)

    def ask(self, kind, **message):
        """Send a message and wait for an answer of a kind; an error of the server is raised."""
        self.socket.sendall(json.dumps(message).encode() + b"\n")
        for line in self.lines:
            answer = json.loads(line)
            if answer["type"] == "error":
                raise RuntimeError(answer["reason"])
            if answer["type"] == kind:
                return answer
        raise ConnectionError("the server has closed the connection")

    def expose(self, t_s, quaternion, rate_deg_s=(0.0, 0.0, 0.0)):
        """Solution of a frame about a time, for an attitude ICRS to camera (scalar last) and a rate in camera axes."""
        return self.ask("solution", type="attitude", t_s=t_s, quaternion=quaternion, rate_deg_s=rate_deg_s)


def attitude_at(t_s, rate_deg_s=0.05):
    """A camera that turns about its boresight, which points to RA 90°, Dec 0°."""
    half = math.radians(rate_deg_s * t_s) / 2.0
    c, s = math.cos(half) * math.sqrt(0.5), math.sin(half) * math.sqrt(0.5)
    return [-c, s, s, c], [0.0, 0.0, rate_deg_s]


if __name__ == "__main__":
    camera = Camera(int(sys.argv[1]))
    for k in range(int(sys.argv[2]) if len(sys.argv) > 2 else 20):
        found = camera.expose(0.5 * k, *attitude_at(0.5 * k))
        print(f"{found['t_s']:8.3f} s  {found['status']:<12} {found['mode']:<14} {found['quaternion']}")
