"""A gRPC client over stubs generated from proto/: pushes epochs, by call and by stream, and lists what is
stored.

Usage: client.py STUBS HOST:PORT NAVIGATION EPOCHS.json
Prints one JSON object: the session and its solutions as the gRPC door gives them.
"""

import json
import sys

stubs, server, navigation, epochs = sys.argv[1:5]
sys.path.insert(0, stubs)

import grpc
from google.protobuf import json_format
from graphfix.v1 import navigation_pb2, navigation_pb2_grpc
from graphfix.v1 import observation_pb2
from graphfix.v1 import positioning_pb2, positioning_pb2_grpc
from graphfix.v1 import sessions_pb2, sessions_pb2_grpc
from graphfix.v1 import solutions_pb2, solutions_pb2_grpc

channel = grpc.insecure_channel(server)

with open(navigation, "rb") as file:
    content = file.read()
held = navigation_pb2_grpc.NavigationStub(channel).Push(
    navigation_pb2.PushNavigationRequest(content=content), wait_for_ready=True, timeout=60
)

session = sessions_pb2_grpc.SessionsStub(channel).Create(
    sessions_pb2.CreateSessionRequest(label="python", mode="spp")
).session

push = positioning_pb2.PushEpochsRequest(session=session)
with open(epochs, encoding="utf-8") as file:
    for epoch in json.load(file):
        json_format.ParseDict(epoch, push.epochs.add())
pushed = positioning_pb2_grpc.PositioningStub(channel).PushEpochs(push)
assert all(result.HasField("solution") for result in pushed.results), pushed
assert pushed.durable_through == push.epochs[-1].seq

listed = solutions_pb2_grpc.SolutionsStub(channel).List(
    solutions_pb2.ListSolutionsRequest(session=session)
)
assert list(listed.solutions) == [result.solution for result in pushed.results]

# The same epochs by a stream that breaks after the first, and goes on where the service says.
streamed = sessions_pb2_grpc.SessionsStub(channel).Create(
    sessions_pb2.CreateSessionRequest(label="python stream", mode="spp")
).session


def stream(epochs, **opening):
    """Sends epochs one by one; the answers."""
    opening = positioning_pb2.StreamOpening(
        session=streamed, answers=positioning_pb2.ANSWERS_FULL, **opening
    )
    messages = [positioning_pb2.StreamRequest(opening=opening)]
    messages += [positioning_pb2.StreamRequest(epochs=[epoch]) for epoch in epochs]
    return list(positioning_pb2_grpc.PositioningStub(channel).Stream(iter(messages), timeout=60))


first = stream(push.epochs[:1])
assert first[0].HasField("opened") and not first[0].opened.HasField("durable_through"), first
assert first[-1].durable_through == push.epochs[0].seq, first
rest = stream(push.epochs, last_acknowledged=0)
assert rest[0].opened.durable_through == push.epochs[0].seq, rest
answered = [result.solution for answer in rest for result in answer.results]
assert answered[0] == answered[1], "an epoch that was sent again has another answer"
solved = [(solution.seq, solution.position) for solution in answered[1:]]
assert solved == [(solution.seq, solution.position) for solution in listed.solutions]
try:
    stream([push.epochs[0]], last_acknowledged=10**6)
    raise SystemExit("an acknowledgement that the service has not given was taken")
except grpc.RpcError as error:
    assert error.code() == grpc.StatusCode.FAILED_PRECONDITION, error

try:
    sessions_pb2_grpc.SessionsStub(channel).Get(sessions_pb2.GetSessionRequest(session="ses_0"))
    raise SystemExit("a session that is not there was answered")
except grpc.RpcError as error:
    assert error.code() == grpc.StatusCode.NOT_FOUND, error

print(
    json.dumps(
        {
            "session": session,
            "ephemerides": held.ephemerides,
            "solutions": [
                {
                    "seq": solution.seq,
                    "status": solution.status,
                    "ecef": [
                        solution.position.ecef.x_m,
                        solution.position.ecef.y_m,
                        solution.position.ecef.z_m,
                    ],
                    "hash": solution.provenance.configuration_hash,
                }
                for solution in listed.solutions
            ],
        }
    )
)
