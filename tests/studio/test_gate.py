"""Who may talk to the studio."""

import pytest
from starlette.websockets import WebSocketDisconnect

from tests.studio.talking import ADDRESS, PORT, TOKEN, socket_of, studio, write_recipe

FILES = ("/", "/static/index.html", "/socket/key", "/prepare/key", "/static/../app.py", "/nothing")


@pytest.fixture
def browser(tmp_path):
    path, _ = write_recipe(tmp_path)
    with studio(path) as found:
        yield found


@pytest.mark.parametrize("address", FILES)
def test_without_the_cookie_nothing_is_told(browser, address):
    browser.cookies.clear()
    answer = browser.get(address)
    assert answer.status_code == 403
    assert "heartcase studio printed" in answer.text


@pytest.mark.parametrize("token", ["", "wrong", TOKEN + "x", "ä"])
def test_a_wrong_token_gives_no_cookie(browser, token):
    browser.cookies.clear()
    answer = browser.get("/", params={"token": token})
    assert answer.status_code == 403
    assert "set-cookie" not in answer.headers


def test_the_token_gives_a_cookie_that_scripts_and_other_sites_cannot_use(browser):
    answer = browser.get("/", params={"token": TOKEN})
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=Strict"} <= set(answer.headers["set-cookie"].split("; "))
    # every server of this machine is sent it
    assert TOKEN not in answer.headers["set-cookie"]


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"host": f"evil.example:{PORT}"},
        {"host": "127.0.0.1:1"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": f"https://127.0.0.1:{PORT}"},
    ],
)
def test_other_hosts_and_origins_are_refused_with_the_cookie_too(browser, headers):
    assert browser.get("/", headers=headers).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect),
        browser.websocket_connect(socket_of(browser), headers={"origin": ADDRESS} | headers),
    ):
        pass


@pytest.mark.parametrize("cookie", [None, "wrong", TOKEN])
def test_a_socket_needs_the_cookie_and_an_origin(browser, cookie):
    with pytest.raises(WebSocketDisconnect), browser.websocket_connect(socket_of(browser)):
        pass
    browser.cookies.clear()
    if cookie:
        browser.cookies.set(f"heartcase-{PORT}", cookie)
    with pytest.raises(WebSocketDisconnect), browser.websocket_connect(socket_of(browser), headers={"origin": ADDRESS}):
        pass


def test_the_page_may_run_its_own_files_alone(browser):
    for address in ("/", "/static/index.html"):
        answer = browser.get(address)
        assert answer.status_code == 200
        policy = dict(part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
        assert policy["frame-ancestors"] == "'none'"
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cache-control"] == "no-store"
        assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize(
    "address", ["/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py", "/static//etc/passwd"]
)
def test_paths_do_not_leave_the_pages_folder(browser, address):
    assert browser.get(address).status_code in (403, 404)


def test_the_pages_files_hold_no_inline_script_and_load_nothing_from_elsewhere():
    import re

    from heartcase.studio.serving.app import PAGE

    for file in PAGE.rglob("*"):
        if file.suffix not in (".html", ".js", ".css"):
            continue
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".html":
            # the template of files that need no server holds their script; from here the policy lets none of it run
            text = text if file.parent.name != "offline" else re.sub(r"<script[^>]*>(DATA|SCRIPT)</script>", "", text)
            assert not re.search(r"<script(?![^>]*\ssrc=)", text), file.name
            assert not re.search(r"\son\w+\s*=|\sstyle\s*=|javascript:", text), file.name
        found = re.findall(r"https?://(?!www\.w3\.org/)[^\s\"'`)]+", text)
        assert not found, (file.name, found)
        assert not re.search(r"\beval\(|new Function|innerHTML|outerHTML|insertAdjacentHTML|document\.write", text), (
            file.name
        )


def test_the_page_itself_gets_its_socket(browser):
    with browser.websocket_connect(socket_of(browser), headers={"origin": ADDRESS}) as socket:
        assert socket.receive_json()["kind"] == "progress"


def test_what_is_open_has_an_address_that_takes_the_token(browser):
    address = browser.opened.address
    assert browser.opened.path.stem not in address
    browser.cookies.clear()
    assert browser.get(address).status_code == 403
    answer = browser.get(address, params={"token": TOKEN})
    assert (answer.status_code, answer.headers["location"]) == (303, address)
    assert b'id="desk"' in browser.get(address).content


@pytest.mark.parametrize("path", ["//evil.example", "/static/main.js", "/prepare/a/b", "/prepare//evil.example"])
def test_the_token_opens_pages_alone(browser, path):
    browser.cookies.clear()
    assert browser.get(ADDRESS + path, params={"token": TOKEN}).status_code == 403


def test_what_is_not_open_leads_to_the_start_page(browser):
    answer = browser.get("/prepare/nothing")
    assert (answer.status_code, answer.headers["location"]) == (303, "/#closed")
    with (
        pytest.raises(WebSocketDisconnect),
        browser.websocket_connect(f"ws://127.0.0.1:{PORT}/socket/nothing", headers={"origin": ADDRESS}),
    ):
        pass
