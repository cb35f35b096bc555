"""A server that speaks S3 and checks credentials, in a process of its own, which may be stopped and come back."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import boto3
import pytest
import s3fs
from botocore.exceptions import EndpointConnectionError

START_S = 60.0
KEYS = {"AWS_ACCESS_KEY_ID": "nobody", "AWS_SECRET_ACCESS_KEY": "nothing", "AWS_DEFAULT_REGION": "us-east-1"}
EVERYTHING = {"Version": "2012-10-17", "Statement": [{"Effect": "Allow", "Action": "*", "Resource": "*"}]}
# What the server lets pass before it asks who it is: the requests that `_let_in` makes.
UNASKED = "4"


class Server:
    """A server at a port of this machine. Its contents are lost with its process."""

    def __init__(self, log: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        command = [sys.executable, "-m", "moto.server", "-p", str(self.port)]
        with log.open("wb") as stream:
            environment = {**os.environ, "INITIAL_NO_AUTH_ACTION_COUNT": UNASKED}
            self.process = subprocess.Popen(command, env=environment, stdout=stream, stderr=stream)

    def environment(self) -> dict[str, str]:
        """That in which `s3://lanes` is there."""
        with pytest.MonkeyPatch.context() as patch:
            found = {**KEYS, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.port}"}
            for name, value in found.items():
                patch.setenv(name, value)
            return found | _let_in()


def _let_in() -> dict[str, str]:
    """Make the bucket `lanes` and a user who may do everything; returns the user's keys."""
    until = time.monotonic() + START_S
    while True:
        try:
            boto3.client("s3").create_bucket(Bucket="lanes")
            break
        except EndpointConnectionError:
            assert time.monotonic() < until, "the S3 server does not start"
            time.sleep(0.1)
    iam = boto3.client("iam")
    iam.create_user(UserName="lane")
    iam.put_user_policy(UserName="lane", PolicyName="all", PolicyDocument=json.dumps(EVERYTHING))
    key = iam.create_access_key(UserName="lane")["AccessKey"]
    return {"AWS_ACCESS_KEY_ID": key["AccessKeyId"], "AWS_SECRET_ACCESS_KEY": key["SecretAccessKey"]}


@contextmanager
def server(log: Path) -> Iterator[dict[str, str]]:
    """The environment in which `s3://lanes` is there, for a while."""
    found = Server(log)
    try:
        yield found.environment()
    finally:
        found.process.kill()
        found.process.wait()


@contextmanager
def seen_by_clients(environment: dict[str, str]) -> Iterator[None]:
    """Let clients of this process see the store of an environment, and remember nothing of another one."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        s3fs.S3FileSystem.clear_instance_cache()
        yield
        s3fs.S3FileSystem.clear_instance_cache()


def contents(place: str) -> dict[str, bytes]:
    """The files below a place such as `lanes/d` by their paths, as they are in fact: nothing is remembered."""
    store = s3fs.S3FileSystem(use_listings_cache=False, skip_instance_cache=True)
    return {name.removeprefix(f"{place}/"): store.cat_file(name) for name in store.find(place)}


class Gate:
    """A port before a server that can be closed: connections to it are refused, those through it end."""

    def __init__(self, port: int) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self._target = port
        self._process: subprocess.Popen[bytes] | None = None

    def open(self) -> None:
        """Let connections through from now on."""
        command = [sys.executable, "-c", RELAY, str(self.port), str(self._target)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == b"open\n"

    def close(self) -> None:
        """End all connections, and refuse new ones."""
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.communicate()
            self._process = None


RELAY = """
import asyncio, sys
port, target = map(int, sys.argv[1:])
async def pump(reader, writer):
    try:
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    except OSError:
        pass
    finally:
        writer.close()
async def meet(reader, writer):
    their_reader, their_writer = await asyncio.open_connection("127.0.0.1", target)
    await asyncio.gather(pump(reader, their_writer), pump(their_reader, writer))
async def main():
    server = await asyncio.start_server(meet, "127.0.0.1", port)
    print("open", flush=True)
    await server.serve_forever()
asyncio.run(main())
"""
