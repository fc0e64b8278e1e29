"""Memory that is used again for copies of large messages."""

from robbie_mp.connect.ros2.side import ReusedMemory


def test_copies_have_the_bytes_and_the_size_of_each_message() -> None:
    memory = ReusedMemory()
    for data in (b"first", b"a longer one", b"", b"short"):
        assert bytes(memory.copy(memoryview(data))) == data
        assert memory.copy(data) is memory.copy(data)
