"""A robot behind a socket, for the test of a loop: four drives that reach half of a reference's distance in a period.

From the 100th to the 150th reference somebody holds its second joint aside. It says its port, and ends with the loop.
"""

import contextlib
import socket
import sys

import numpy as np

listening = socket.create_server(("127.0.0.1", 0))
print(listening.getsockname()[1], flush=True)
line, _ = listening.accept()
q, count = np.zeros(int(sys.argv[1])), 0
with contextlib.suppress(ConnectionError), line, line.makefile("rwb") as stream:
    stream.write(q.tobytes())
    stream.flush()
    while reference := stream.read(2 * q.nbytes):
        wanted = np.frombuffer(reference)[: len(q)]
        q = q + 0.5 * (wanted - q)
        count += 1
        if 100 <= count < 150:
            q[1] = 0.5
        stream.write(q.tobytes())
        stream.flush()
