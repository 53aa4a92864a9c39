"""Who may ask the server, and what browsers may do with the answers."""

from __future__ import annotations

import json

import pytest
from page_server import Served
from toys import painted


@pytest.fixture
def with_token(tmp_path):
    server = Served(tmp_path / "workspace", host="0.0.0.0", token="secret")
    yield server.client
    server.stop()


def code(answer) -> str:
    return json.loads(answer[2])["error"]["code"]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example", "192.168.0.7", ""])
def test_other_names_are_refused(client, host):
    """A page whose owner lets its name point to 127.0.0.1 still sends its own name."""
    answer = client.raw("GET", "/api/jobs", headers={"Host": host.format(port=client.port)})
    assert answer[0] == 421 and code(answer) == "host"


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}", "LOCALHOST", "[::1]:{port}"])
def test_own_names_are_answered(client, host):
    assert client.raw("GET", "/api/jobs", headers={"Host": host.format(port=client.port)})[0] == 200


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "https://evil.example"}, {"Origin": "null"}, {"Origin": "http://127.0.0.1:1"},
     {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"}],
)  # fmt: skip
def test_other_sites_are_refused(client, headers):
    for method, path in (("POST", "/api/jobs?name=a.glb"), ("GET", "/api/jobs")):
        answer = client.raw(method, path, b"x", headers)
        assert answer[0] == 403 and code(answer) == "origin"
    assert client.ask("GET", "jobs")[1] == {"jobs": []}


def test_own_site_and_programs_are_answered(client):
    own = {"Origin": client.base, "Sec-Fetch-Site": "same-origin"}
    assert client.raw("POST", "/api/jobs?name=a.zip", b"x", own)[0] == 422
    assert client.raw("POST", "/api/jobs?name=a.zip", b"x")[0] == 422
    # A link on another site may lead to the page, and to nothing else
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert client.raw("GET", "/", headers=link)[0] == 200
    assert client.raw("GET", "/api/jobs", headers=link)[0] == 403


def test_token_is_asked_for(with_token):
    assert code(with_token.raw("GET", "/api/jobs")) == "token"
    assert with_token.raw("GET", "/")[0] == 401
    for wrong in ({"Authorization": "Bearer secre"}, {"Cookie": "genmf_token=x"}, {"Authorization": "Bearer sécret"}):
        headers = {name: value.encode().decode("latin-1") for name, value in wrong.items()}
        assert with_token.raw("GET", "/api/jobs", headers=headers)[0] == 401
    assert with_token.raw("GET", "/api/jobs?token=secret")[0] == 401  # only the page, which hides it at once
    assert with_token.raw("GET", "/api/jobs", headers={"Authorization": "Bearer secret"})[0] == 200
    status, headers, _ = with_token.raw("GET", "/?token=secret")
    assert status == 303 and headers["location"] == "/"
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie and "samesite=strict" in cookie.lower()
    assert with_token.raw("GET", "/api/jobs", headers={"Cookie": cookie.split(";")[0]})[0] == 200


def test_names_of_a_server_for_others(with_token):
    allowed = {"Authorization": "Bearer secret"}
    for host, status in (("192.168.0.7:80", 200), ("localhost", 200), ("evil.example", 421)):
        assert with_token.raw("GET", "/api/jobs", headers={**allowed, "Host": host})[0] == status


def test_no_script_but_our_own_runs(client):
    for path in ("/", "/app.js", "/api/jobs", "/nothing"):
        headers = client.raw("GET", path)[1]
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
    page = client.raw("GET", "/")[2].decode()
    assert "<script>" not in page and "style=" not in page and "http:" not in page.replace("http://www.w3.org", "")


def test_nothing_else_is_handed_out(client, tmp_path):
    job = client.upload(painted(tmp_path / "toy.ply"), wait=False)
    files = f"/api/jobs/{job['id']}/files"
    for path in (
        "/../setup.cfg", "/%2e%2e/setup.cfg", "/..%2fsetup.cfg", "/static/", "/api/", "/api/jobs/", "/api/jobs/..",
        "/api/jobs/%2e%2e", f"{files}/", f"{files}/..%2fjob.json", f"{files}/job.json", f"{files}/../job.json",
        f"{files}/checkpoint.pt", f"{files}/%2fetc%2fpasswd", f"/api/jobs/{job['id']}/input/toy.ply", "/app.py",
        "//etc/passwd", "/index.html/",
    ):  # fmt: skip
        status, _, body = client.raw("GET", path)
        assert status in (404, 307), path
        assert b"toy.ply" not in body and b"root:" not in body
