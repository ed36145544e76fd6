"""Where the files of a stream lie: a folder, or a prefix of an object store."""
