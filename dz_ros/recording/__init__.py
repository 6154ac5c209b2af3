# SPDX-License-Identifier: Apache-2.0
"""Records ↔ bytes ↔ MCAP: encodings of messages, writing, reading and recovering runs."""
