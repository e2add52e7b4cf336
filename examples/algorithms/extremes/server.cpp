// An algorithm behind the Open Inference Protocol v2: what is asked, checked and answered. Yours goes where find_extremes is
// called.
//
//   ./extremes [PORT]        listens on 127.0.0.1; prints the address that cabinpose's --model takes

#include <grpcpp/grpcpp.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "extremes.hpp"
#include "open_inference.grpc.pb.h"

namespace {

constexpr char kModel[] = "extremes";
constexpr int kMaxMessage = 64 << 20;
constexpr int kMaxSide = 8192;
const std::vector<std::string> kPersons{"standing"}, kJoints{"head", "lhand", "rhand"};

// The bytes of an input by its name, after its type and rank were checked; `shape` gets its sizes.
const std::string& input(const inference::ModelInferRequest& request, const std::string& name, const std::string& datatype,
                         int rank, std::vector<int64_t>& shape) {
  if (request.raw_input_contents_size() != request.inputs_size()) throw std::invalid_argument("raw contents are needed");
  for (int i = 0; i < request.inputs_size(); ++i) {
    const auto& tensor = request.inputs(i);
    if (tensor.name() != name) continue;
    if (tensor.datatype() != datatype || tensor.shape_size() != rank)
      throw std::invalid_argument(name + " is not " + datatype + " of " + std::to_string(rank) + " dimensions");
    shape.assign(tensor.shape().begin(), tensor.shape().end());
    size_t bytes = datatype == "FP64" ? 8 : 4;
    for (int64_t n : shape) {
      if (n < 1 || n > kMaxSide) throw std::invalid_argument(name + " has an impossible shape");
      bytes *= size_t(n);  // at most 8 * 8192^3, which fits
    }
    if (request.raw_input_contents(i).size() != bytes) throw std::invalid_argument(name + " has another number of bytes");
    return request.raw_input_contents(i);
  }
  throw std::invalid_argument(name + " is missing");
}

void output(inference::ModelInferResponse& response, const std::string& name, const std::string& datatype,
            const std::vector<int64_t>& shape, std::string bytes) {
  auto* tensor = response.add_outputs();
  tensor->set_name(name);
  tensor->set_datatype(datatype);
  for (int64_t n : shape) tensor->add_shape(n);
  response.add_raw_output_contents(std::move(bytes));
}

std::string bytes_of(const std::vector<float>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};  // a little-endian machine
}

std::string bytes_of(const std::vector<std::string>& names) {
  std::string bytes;
  for (const std::string& name : names) {
    const auto length = uint32_t(name.size());
    bytes.append(reinterpret_cast<const char*>(&length), sizeof length).append(name);
  }
  return bytes;
}

void answer(const inference::ModelInferRequest& request, inference::ModelInferResponse& response) {
  std::vector<int64_t> size, k_shape;
  const std::string& depth_bytes = input(request, "depth", "FP32", 3, size);
  const std::string& k_bytes = input(request, "camera_k", "FP64", 3, k_shape);
  if (size[0] != 1 || k_shape != std::vector<int64_t>{1, 3, 3}) throw std::invalid_argument("one frame a request");
  std::vector<float> depth(depth_bytes.size() / sizeof(float));
  std::memcpy(depth.data(), depth_bytes.data(), depth_bytes.size());
  double k[9];
  std::memcpy(k, k_bytes.data(), sizeof k);
  for (double number : k)
    if (!std::isfinite(number)) throw std::invalid_argument("camera_k is not finite");
  if (!(k[0] > 0 && k[4] > 0)) throw std::invalid_argument("focal lengths are positive");

  const Found found = find_extremes(depth, int(size[1]), int(size[2]), {k[0], k[4], k[2], k[5]});

  std::vector<float> joints, presence;
  for (const Joint& joint : {found.head, found.left_hand, found.right_hand}) {  // the order of kJoints
    joints.insert(joints.end(), {joint.at.x, joint.at.y, joint.at.z});
    presence.push_back(joint.presence);
  }
  const auto persons = int64_t(kPersons.size()), count = int64_t(kJoints.size());
  output(response, "joints_3d", "FP32", {1, persons, count, 3}, bytes_of(joints));
  output(response, "presence", "FP32", {1, persons, count}, bytes_of(presence));
  output(response, "person_names", "BYTES", {persons}, bytes_of(kPersons));
  output(response, "joint_names", "BYTES", {count}, bytes_of(kJoints));
}

class Service final : public inference::GRPCInferenceService::Service {
  grpc::Status ServerLive(grpc::ServerContext*, const inference::ServerLiveRequest*,
                          inference::ServerLiveResponse* response) override {
    response->set_live(true);
    return grpc::Status::OK;
  }

  grpc::Status ServerReady(grpc::ServerContext*, const inference::ServerReadyRequest*,
                           inference::ServerReadyResponse* response) override {
    response->set_ready(true);
    return grpc::Status::OK;
  }

  grpc::Status ModelReady(grpc::ServerContext*, const inference::ModelReadyRequest* request,
                          inference::ModelReadyResponse* response) override {
    response->set_ready(request->name() == kModel);
    return grpc::Status::OK;
  }

  grpc::Status ModelMetadata(grpc::ServerContext*, const inference::ModelMetadataRequest* request,
                             inference::ModelMetadataResponse* response) override {
    if (request->name() != kModel) return {grpc::StatusCode::NOT_FOUND, "this server has the model extremes"};
    response->set_name(kModel);
    response->add_versions("1");
    response->set_platform("cabinpose_pose_1");  // the version of the table of tensors
    const auto add = [](auto* tensor, const char* name, const char* datatype, const std::vector<int64_t>& shape) {
      tensor->set_name(name);
      tensor->set_datatype(datatype);
      for (int64_t n : shape) tensor->add_shape(n);
    };
    const auto persons = int64_t(kPersons.size()), count = int64_t(kJoints.size());
    add(response->add_inputs(), "depth", "FP32", {1, -1, -1});
    add(response->add_inputs(), "camera_k", "FP64", {1, 3, 3});
    add(response->add_outputs(), "joints_3d", "FP32", {1, persons, count, 3});
    add(response->add_outputs(), "presence", "FP32", {1, persons, count});
    add(response->add_outputs(), "person_names", "BYTES", {persons});
    add(response->add_outputs(), "joint_names", "BYTES", {count});
    return grpc::Status::OK;
  }

  grpc::Status ModelInfer(grpc::ServerContext*, const inference::ModelInferRequest* request,
                          inference::ModelInferResponse* response) override {
    if (request->model_name() != kModel) return {grpc::StatusCode::NOT_FOUND, "this server has the model extremes"};
    response->set_model_name(kModel);
    response->set_model_version("1");
    response->set_id(request->id());
    try {
      answer(*request, *response);
    } catch (const std::invalid_argument& error) {
      return {grpc::StatusCode::INVALID_ARGUMENT, error.what()};
    }
    return grpc::Status::OK;
  }
};

}  // namespace

int main(int argc, char** argv) {
  Service service;
  grpc::ServerBuilder builder;
  int port = argc > 1 ? std::atoi(argv[1]) : 8001;
  builder.AddListeningPort("127.0.0.1:" + std::to_string(port), grpc::InsecureServerCredentials(), &port);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.SetMaxReceiveMessageSize(kMaxMessage);
  builder.RegisterService(&service);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  if (!server || port == 0) {
    std::cerr << "cannot listen on that port\n";
    return 2;
  }
  std::cout << "grpc://127.0.0.1:" << port << "/" << kModel << std::endl;
  server->Wait();
}
