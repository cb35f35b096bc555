"""Executors of shards beyond this machine."""
