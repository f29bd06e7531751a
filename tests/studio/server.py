"""A studio as its user has it: a process of its own, for tests."""

import http.client
import os
import queue
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit

START = 300  # seconds that a loaded machine may take


class Server:
    """A running studio.

    Attributes:
        address: What it shows, with its key.
        port: Where it listens.
        key: Its key.
    """

    def __init__(self, process, address):
        self.process, self.address = process, address
        self.port = urlsplit(address).port
        self.key = parse_qs(urlsplit(address).query)["key"][0]
        self.cookie = f"evogymcm-studio-{self.port}={self.key}"

    def ask(self, path, method="GET", host=None, **headers):
        """Returns status, headers and body of an answer; None leaves the cookie out."""
        headers = {"Host": host or f"127.0.0.1:{self.port}", "Cookie": self.cookie} | headers
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in headers.items():
                if value is not None:
                    connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def kill(self):
        """Ends it as a power cut would."""
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait(120)


@contextmanager
def serving(folder, port=0):
    """Runs a studio for a folder."""
    command = [sys.executable, "-m", "evogymcm", "studio", str(folder), "--port", str(port), "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    lines = queue.Queue()
    threading.Thread(target=lambda: [lines.put(line) for line in process.stdout], daemon=True).start()
    try:
        said = []
        while not (said and "http://" in said[-1]):
            assert process.poll() is None, said
            said.append(lines.get(timeout=START))
        yield Server(process, said[-1].split()[-1])
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(120)
