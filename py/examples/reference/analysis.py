# %% Log
from mirrorball import simulate
from mirrorball.analysis import Log

for preset in ("default", "nubot2013"):
    simulate("config/scenarios/demo.toml", seed=3, duration_s=1.0, preset=preset, record=f"{preset}.mcap")
log = Log("default.mcap")

# %% LogError
from mirrorball.analysis import LogError

try:
    Log("samples/sequence/robot.toml")
except LogError as error:
    print(error)

# %% cycles, summary, dropouts
from mirrorball.analysis import cycles, dropouts, summary

run = cycles(log)
print(summary(run), dropouts(run))

# %% table
from mirrorball.analysis import table

odometry = table(log, "/odometry", start_s=0.5)

# %% stream
from mirrorball.analysis import stream

mean_m = [piece["error_m"].mean() for piece in stream(log, "/cycle", rows=20)]

# %% points
from mirrorball.analysis import points

line_points = points(log)

# %% exposure
from mirrorball.analysis import exposure

light = exposure(log, every=10)

# %% findings, Finding
from mirrorball.analysis import Finding, findings

moments: list[Finding] = findings(log)
for moment in moments:
    print(moment.severity, moment.sentence)

# %% findings_table
from mirrorball.analysis import findings_table

print(findings_table(moments)[["kind", "start_s", "size"]])

# %% images_of
from mirrorball.analysis import images_of

pictures = images_of(log, moments)

# %% difference, paired_difference
from mirrorball.analysis import difference, paired_difference

other = cycles("nubot2013.mcap")
apart_m = difference(run, other)["apart_m"]
print(paired_difference(run, other)["difference"])

# %% report, Report
from mirrorball.analysis import Report, report

written: Report = report(log, folder="page")
print(written.page)

# %% compare
from mirrorball.analysis import compare

compare("default.mcap", "nubot2013.mcap", folder="both")

# %% write_parquet
from mirrorball.analysis import write_parquet

paths = write_parquet(log, folder="tables", topics=["/cycle"])
