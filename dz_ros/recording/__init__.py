"""Records ↔ bytes ↔ MCAP: encodings of messages, writing, reading and recovering runs."""
