# %% Log
from mirrorball import simulate
from mirrorball.log import Log

simulate("config/scenarios/demo.toml", seed=3, duration_s=0.3, record="game.mcap")
log = Log("game.mcap")
print(log.topics, log.message_counts["/cycle"], log.about["seed"])

# %% LogMessage
from mirrorball.log import LogMessage

for message in log.messages("/odometry"):
    assert isinstance(message, LogMessage)
    print(message.stamp_s, message.message.dx)

# %% LogError
from mirrorball.log import LogError

try:
    Log("samples/sequence/field.toml")
except LogError as error:
    print(error)
