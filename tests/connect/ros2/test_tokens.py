"""Keys, tokens and attachments beside those of rmw_zenoh's design document, and of nodes of Jazzy."""

import pytest

from robbie_mp.connect.bridge.mapping import Quality
from robbie_mp.connect.ros2.side import NodeName, RosChannel
from robbie_mp.connect.ros2.tokens import (
    PUBLISHER,
    SUBSCRIPTION,
    Attachment,
    data_key,
    endpoint_token,
    gid,
    node_token,
    quality_text,
)

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TYPE = f"std_msgs::msg::dds_::String_/{STRING}"


def chatter(name: str, **quality: int) -> RosChannel:
    return RosChannel(name, "std_msgs/msg/String", STRING, Quality(**quality))  # type: ignore[arg-type]


def test_examples_of_the_design_document_are_met() -> None:
    listener, talker = "aac3178e146ba6f1fc6e6a4085e77f21", "8b20917502ee955ac4476e0266340d5c"
    assert data_key(0, chatter("/chatter")) == f"0/chatter/{TYPE}"
    assert data_key(0, chatter("/robot1/chatter")) == f"0/robot1/chatter/{TYPE}"
    node = NodeName(2, "/", "listener")
    assert node_token(listener, node) == f"@ros2_lv/2/{listener}/0/0/NN/%/%/listener"
    assert endpoint_token(listener, node, 10, SUBSCRIPTION, chatter("/chatter")) == (
        f"@ros2_lv/2/{listener}/0/10/MS/%/%/listener/%chatter/{TYPE}/::,10:,:,:,,"
    )
    assert endpoint_token(
        talker, NodeName(2, "/", "talker"), 10, PUBLISHER, chatter("/chatter", depth=7)
    ) == (f"@ros2_lv/2/{talker}/0/10/MP/%/%/talker/%chatter/{TYPE}/::,7:,:,:,,")


# Captured by others from rmw_zenoh 0.2.11 of Jazzy, demo_nodes_cpp and `ros2 topic pub`.
@pytest.mark.parametrize(
    ("node", "zenoh_id", "entity", "channel", "end", "attached"),
    [
        (
            NodeName(0, "/", "talker"),
            "a52f44b281e33efee354a095ad96d9e9",
            11,
            chatter("/chatter", depth=7),
            f"%/%/talker/%chatter/{TYPE}/::,7:,:,:,,",
            "1a0000000000000005301f32f9a2dc18103e1e8c9234b1602a9dba5860eed86e33",
        ),
        (
            NodeName(7, "/cell4", "gw"),
            "6977b59f87229328a8d406ad77b301a6",
            11,
            chatter("/cell4/chatter", depth=7),
            f"%/%cell4/gw/%cell4%chatter/{TYPE}/::,7:,:,:,,",
            "1a00000000000000699e1332f9a2dc1810b7aef695b2cd04ba45f9eed0c4a6c584",
        ),
        (
            NodeName(0, "/", "p_tl"),
            "914ec2c920f5151f26394cf0ba959999",
            4,
            chatter("/q_transient", is_latched=True),
            f"%/%/p_tl/%q_transient/{TYPE}/:1:,10:,:,:,,",
            "15000000000000008903674cf9a2dc1810b9249d3fec6b1be4c0c8a0e3eb3550bb",
        ),
        (
            NodeName(0, "/", "p_be"),
            "45000cc3452ec777e9664270c90b5af",
            4,
            chatter("/q_best_effort", is_reliable=False),
            f"%/%/p_be/%q_best_effort/{TYPE}/2::,10:,:,:,,",
            "150000000000000058d1b24cf9a2dc1810a4461b1ae3b3b1de4a54c9c5e9e88fd0",
        ),
        (
            NodeName(0, "/", "p_depth42"),
            "4d5b53bcdd3d15e71bef6b55f1997400",
            4,
            chatter("/q_depth42", depth=42),
            f"%/%/p_depth42/%q_depth42/{TYPE}/::,:,:,:,,",
            "1500000000000000c2bec64cf9a2dc1810c4fac2c77aa599d761ccd1c0dd836e24",
        ),
    ],
)
def test_tokens_and_attachments_are_those_of_real_nodes(
    node: NodeName, zenoh_id: str, entity: int, channel: RosChannel, end: str, attached: str
) -> None:
    token = endpoint_token(zenoh_id, node, entity, PUBLISHER, channel)
    assert token == f"@ros2_lv/{node.domain}/{zenoh_id}/0/{entity}/MP/{end}"
    attachment = Attachment.decode(bytes.fromhex(attached))
    assert attachment is not None
    assert attachment.gid == gid(token)
    assert attachment.encode().hex() == attached


def test_quality_of_service_leaves_out_what_is_default() -> None:
    assert quality_text(Quality(is_reliable=False, is_latched=True, depth=1)) == "2:1:,1:,:,:,,"


def test_wrong_attachments_mean_nothing() -> None:
    assert Attachment.decode(b"") is None
    assert Attachment.decode(bytes(33)) is None
    assert Attachment.decode(bytes(34)) is None
