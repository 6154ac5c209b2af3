# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dz_ros.recording.cdr import ArrayCodec, encode_string
from dz_ros.recording.topic_counts import TopicCounter


def test_topic_counter_reads_seq_where_there_is_one():
    counter = TopicCounter('std_msgs/msg/Float64MultiArray', True)
    codec, other = ArrayCodec(('seq', 'stamp')), ArrayCodec(('xxx', 'stamp'))
    sizes = 0
    for payload in (codec.encode([0, 0]), codec.encode([1, 0]), other.encode([9, 9]),
                    codec.encode([3, 0]), b'garbage'):
        counter.add(payload)
        sizes += len(payload)
    found = counter.summary()
    assert (found.messages, found.bytes, found.missing, found.duplicates) == (5, sizes, 1, 0)


def test_topic_counter_leaves_text_alone():
    counter = TopicCounter('std_msgs/msg/String', False)
    for text in ('0', '5', '5'):
        counter.add(encode_string(text))
    assert counter.summary().missing == counter.summary().duplicates == 0
