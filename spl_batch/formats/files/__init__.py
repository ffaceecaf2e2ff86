"""Files of any kind: whole or not there, on a disk or an object store."""
