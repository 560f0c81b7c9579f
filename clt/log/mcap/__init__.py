"""The MCAP container: bytes, records, scan, table, write."""
