"""The comment of the GitLab job reaches the merge request."""

from __future__ import annotations

import os
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from urllib.parse import parse_qs

import yaml

from support.markdown import ROOT, blocks

JOB = {"CI_PROJECT_ID": "5", "CI_MERGE_REQUEST_IID": "7", "TOKEN": "secret"}


def test_the_summary_is_posted_as_a_note(tmp_path: Path) -> None:
    (job,) = (block.text for block in blocks(ROOT / "docs/ci.md") if "after_script" in block.text)
    (step,) = yaml.safe_load(job)["accuracy"]["after_script"]
    summary = "| gate | failed & so on |\n"
    (tmp_path / "summary.md").write_text(summary)
    requests: list[tuple[str, str | None, str]] = []

    class Answer(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            requests.append((self.path, self.headers["PRIVATE-TOKEN"], parse_qs(body)["body"][0]))
            self.send_response(201)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        own = {"CI_API_V4_URL": f"http://127.0.0.1:{server.server_port}/api/v4", "no_proxy": "*", **JOB}
        subprocess.run(["bash", "-euc", step], cwd=tmp_path, env=os.environ | own, check=True, timeout=60)
    assert requests == [("/api/v4/projects/5/merge_requests/7/notes", "secret", summary)]
