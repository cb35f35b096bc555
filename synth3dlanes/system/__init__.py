"""What knows nothing of roads: files, processes, errors, text formats, types of arrays."""
