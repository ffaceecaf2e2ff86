import time, sys, numpy as np, pyarrow as pa, pyarrow.parquet as pq
from pathlib import Path
from spl_batch.io.tables import read_columns, writing
from spl_batch.model import COLUMNS, TILE_COLUMNS
f = max(Path("/work/try/P/o/ref/store/tiles").glob("*.parquet"), key=lambda p: p.stat().st_size)
m = pq.ParquetFile(f).metadata; n = m.num_rows; print(n, m.num_row_groups, f.stat().st_size / n)
def best(fn, k=5):
    t = []
    for _ in range(k):
        a = time.process_time(); fn(); t.append(time.process_time() - a)
    return min(t) / n * 1e9
cols = read_columns(f, TILE_COLUMNS)
out = Path("/work/try/P/t/x.parquet")
def wr(names, G=16384):
    with writing(out, {k: COLUMNS[k].dtype for k in names}, sought=()) as w:
        for a in range(0, n, G): w.write({k: cols[k][a:a+G] for k in names})
tot=0
for name in TILE_COLUMNS:
    size = sum(m.row_group(g).column(m.schema.names.index(name)).total_compressed_size for g in range(m.num_row_groups)) / n
    print(f"{name:18s} {str(cols[name].dtype):8s} {size:6.2f} B/pt  read {best(lambda: read_columns(f,[name])):6.1f} write {best(lambda: wr([name])):6.1f} ms/M")
print("all read", best(lambda: read_columns(f, TILE_COLUMNS)), "write", best(lambda: wr(TILE_COLUMNS)), "write one group", best(lambda: wr(TILE_COLUMNS, n)))
import zlib, hashlib
b=f.read_bytes()
print("blake2b", best(lambda: hashlib.blake2b(b).digest()), "crc32", best(lambda: zlib.crc32(b)), "sha1", best(lambda: hashlib.sha1(b).digest()))
try:
    import google_crc32c; print("gcrc32c", best(lambda: google_crc32c.value(b)))
except ImportError as e: print(e)
