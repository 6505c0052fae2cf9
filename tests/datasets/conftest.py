"""A local server in place of the public one, and folders of the virtual person."""

import hashlib
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import opensim
import pytest

from wrapjax.datasets.public_recordings import PublicFile, PublicRecording
from wrapjax.datasets.virtual_person.leg import build_leg_model
from wrapjax.datasets.virtual_person.true_parameters import read_true_parameters
from wrapjax.datasets.virtual_person.virtual_subject import Series, write_virtual_subject


@dataclass
class Server:
    """Files by path, number of requests of each still to be refused, and requests received."""

    files: dict[str, bytes] = field(default_factory=dict)
    refusals: dict[str, int] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    address: str = ""


@pytest.fixture
def server():
    """Serve on a free port of this machine."""
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            state.asked.append(self.path)
            left = state.refusals.get(self.path, 0)
            state.refusals[self.path] = left - 1
            status = 503 if left > 0 else 200 if self.path in state.files else 404
            body = state.files[self.path] if status == 200 else b""
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments):
            """Keep quiet."""

    listening = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    listening.daemon_threads = False
    thread = threading.Thread(target=listening.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    state.address = f"http://127.0.0.1:{listening.server_port}"
    yield state
    listening.shutdown()
    thread.join()
    listening.server_close()


@pytest.fixture(autouse=True)
def empty_cache(tmp_path_factory, monkeypatch):
    """Start every test with an empty cache and without waiting before retries."""
    monkeypatch.setenv("WRAPJAX_CACHE", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.setattr("pooch.core.time.sleep", lambda seconds: None)


#: Two files, one of which names the other.
CONTENT = {"walk.mot": b"forces", "walk.xml": b"<datafile>walk.mot</datafile>"}


def checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def recording(server):
    """A recording of two files that the server provides."""
    place = "people/repository/abc123/folder/below"
    server.files |= {f"/{place}/{name}": content for name, content in CONTENT.items()}
    return PublicRecording(
        name="healthy_overground",  # The package contains its settings.
        about="Somebody",
        place=place,
        licence="Apache-2.0",
        files=(
            PublicFile("walk.mot", "trials/walk/ground_forces.mot", checksum(CONTENT["walk.mot"])),
            PublicFile(
                "walk.xml",
                "trials/walk/external_loads.xml",
                checksum(CONTENT["walk.xml"]),
                renamed=(("walk.mot", "ground_forces.mot"),),
            ),
        ),
    )


@pytest.fixture(scope="session")
def leg_file(tmp_path_factory):
    """Model of the virtual leg."""
    opensim.Logger.setLevelString("Off")
    path = tmp_path_factory.mktemp("leg") / "model.osim"
    build_leg_model(path)
    return path


@pytest.fixture(scope="session")
def clean_folder(tmp_path_factory):
    """A virtual subject without noise: one cycle at each of two speeds."""
    folder = tmp_path_factory.mktemp("subjects") / "clean"
    series = (Series(0.8, 1, 0), Series(1.2, 0, 1))
    write_virtual_subject(folder, seed=3, emg_noise=0.0, moment_noise=0.0, series=series)
    return folder


@pytest.fixture(scope="session")
def clean_truth(clean_folder):
    return read_true_parameters(clean_folder)
