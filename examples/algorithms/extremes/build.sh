#!/bin/sh
# Build ./extremes here, or in the folder that is given. Debian: apt-get install g++ libgrpc++-dev libprotobuf-dev protobuf-compiler-grpc pkg-config
set -eu
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "${1:-$here}" && cd "${1:-$here}"
flags=$(pkg-config --cflags --libs grpc++ protobuf)
protoc -I "$here" --cpp_out=. --grpc_out=. --plugin=protoc-gen-grpc="$(command -v grpc_cpp_plugin)" open_inference.proto
g++ -std=c++20 -O2 -Wall -Wextra -I. -I "$here" "$here"/*.cpp open_inference.pb.cc open_inference.grpc.pb.cc \
  -o extremes $flags
