"""The container: an MCAP file, none of whose bytes is trusted before it is verified.

The readers of the mcap package (1.6) verify neither the summary's checksum nor a size before they
allocate it: one flipped bit in the header of a zstd frame makes them allocate gigabytes. Here every
length is compared with the size of the file and with a cap, and every checksum is verified, before
mcap parses a record.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from oes.record.errors import episode_errors

RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
CHUNK_HEAD = struct.Struct("<QQQII")
TAIL_BYTES = 37  # the footer record and the closing magic
FOOTER_CRC_AT = 25  # the summary's checksum covers the footer up to itself
DATA_END_BYTES = 13
BLOCK_BYTES = 1 << 20
MAX_CHUNK_BYTES = 64 << 20


class Message(NamedTuple):
    """One serialized message of a chunk."""

    channel_id: int
    sequence: int
    log_time: int
    data: memoryview


@dataclass(frozen=True)
class Summary:
    """The verified summary section of a file; ``counts`` are the messages by topic."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: tuple[ChunkIndex, ...]
    counts: dict[str, int]


class Bag:
    """One open MCAP file; a context manager. Every method raises EpisodeError for damage."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with episode_errors(path):
            self._file = path.open("rb")
            self._size = path.stat().st_size

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def summary(self) -> Summary:
        """Parse the summary section after its checksum has been verified."""
        with episode_errors(self.path):
            return _parse_summary(self._summary_section()[1])

    def messages(self, chunk: ChunkIndex) -> Iterator[Message]:
        """The messages of one chunk, after its sizes and its checksum have been verified."""
        with episode_errors(self.path):
            opcode, body = _one_record(self._read(chunk.chunk_start_offset, chunk.chunk_length))
            if opcode != Opcode.CHUNK:
                raise ValueError(f"no chunk at byte {chunk.chunk_start_offset}")
            data = unpack(body)
        return messages(data)

    def verify(self) -> None:
        """Verify every byte by the checksums of the data section and of the summary."""
        with episode_errors(self.path):
            data_end = self._summary_section()[0] - DATA_END_BYTES
            opcode, body = _one_record(self._read(data_end, DATA_END_BYTES))
            if opcode != Opcode.DATA_END:
                raise ValueError("the data section does not end where the summary begins")
            crc = 0
            for start in range(0, data_end, BLOCK_BYTES):  # bounds memory for any file size
                crc = zlib.crc32(self._read(start, min(BLOCK_BYTES, data_end - start)), crc)
            if crc != int.from_bytes(body, "little"):
                raise ValueError("checksum of the data section differs")

    def _read(self, start: int, length: int) -> bytes:
        """``length`` bytes, which must exist and not exceed the cap, before they are allocated."""
        if not (0 <= start <= start + length <= self._size and length <= MAX_CHUNK_BYTES):
            raise ValueError(f"bytes {start} to {start + length} of a file of {self._size}")
        self._file.seek(start)
        return self._file.read(length)

    def _summary_section(self) -> tuple[int, bytes]:
        """Offset and bytes of the summary section, verified by its checksum."""
        if self._size < TAIL_BYTES:
            raise ValueError("truncated: too short for an MCAP file")
        tail = self._read(self._size - TAIL_BYTES, TAIL_BYTES)
        if not tail.endswith(MCAP0_MAGIC):
            raise ValueError("truncated: the file does not end as an MCAP file")
        opcode, body = _one_record(tail[: -len(MCAP0_MAGIC)])
        if opcode != Opcode.FOOTER:
            raise ValueError("no footer")
        footer = Footer.read(ReadDataStream(BytesIO(body)))
        if footer.summary_start == 0 or footer.summary_crc == 0:
            raise ValueError("no summary with a checksum: another program wrote this file")
        summary = self._read(footer.summary_start, self._size - TAIL_BYTES - footer.summary_start)
        if zlib.crc32(tail[:FOOTER_CRC_AT], zlib.crc32(summary)) != footer.summary_crc:
            raise ValueError("checksum of the summary differs")
        return footer.summary_start, summary


def records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and body of each record in ``data``, up to the first that does not fit."""
    offset = 0
    while offset + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        offset += RECORD_HEAD.size
        if length > len(data) - offset:
            return
        yield opcode, data[offset : offset + length]
        offset += length


def unpack(body: memoryview) -> memoryview:
    """Decompress a chunk record. Raises ValueError for impossible sizes or a wrong checksum."""
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
    packed_at = CHUNK_HEAD.size + name_length + 8
    compression = bytes(body[CHUNK_HEAD.size : packed_at - 8])
    packed_size = int.from_bytes(body[packed_at - 8 : packed_at], "little")
    packed = body[packed_at:]
    if len(packed) != packed_size or compression not in (b"", b"zstd"):
        raise ValueError(f"a chunk of {len(packed)} packed bytes, compression {compression!r}")
    # zstd allocates the size in its frame's header, so that must agree with the record's first.
    if size > MAX_CHUNK_BYTES or (compression and zstandard.frame_content_size(packed) != size):
        raise ValueError(f"a chunk that claims {size} unpacked bytes")
    data = zstandard.decompress(packed) if compression else bytes(packed)
    if len(data) != size or zlib.crc32(data) != crc:
        raise ValueError("checksum of a chunk differs")
    return memoryview(data)


def messages(data: memoryview) -> Iterator[Message]:
    """The messages among the records of an unpacked chunk."""
    for opcode, body in records(data):
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, _ = MESSAGE_HEAD.unpack_from(body)
            yield Message(channel_id, sequence, log_time, body[MESSAGE_HEAD.size :])


def _one_record(data: bytes) -> tuple[int, memoryview]:
    """The one record that fills ``data``. Raises ValueError if its length is another."""
    found = list(records(memoryview(data)))
    if len(found) != 1 or len(found[0][1]) + RECORD_HEAD.size != len(data):
        raise ValueError("a record is damaged")
    return found[0]


def _parse_summary(data: bytes) -> Summary:
    schemas, channels, chunks, counts = {}, {}, [], {}
    stream = BytesIO(data)
    reader = StreamReader(stream, skip_magic=True).records
    while stream.tell() < len(data):
        match record := next(reader):
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
            case ChunkIndex():
                chunks.append(record)
            case Statistics():
                counts = record.channel_message_counts
    # The statistics omit channels without a message, as of the actions of a single state.
    by_topic = {channel.topic: counts.get(channel.id, 0) for channel in channels.values()}
    return Summary(schemas, channels, tuple(chunks), by_topic)
