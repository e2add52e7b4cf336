// Joints of people from a camera's frame, in C++ with ONNX Runtime alone:
//
//   cabinpose export onnx in_car --whole mm --out in_car-whole.onnx
//   joints in_car-whole.onnx depth.pgm amplitude.pgm FX FY CX CY [K1 K2 P1 P2 K3]
//
// The images are 16-bit PGM files of one camera, depth in millimetres with 0 where nothing was seen; FX to CY are its intrinsics
// in pixels, with whole numbers at pixels' middles, K1 to K3 its lens as OpenCV has it. A line of the output is person, joint, x,
// y, z in metres in the camera's frame (x right, y down, z forward) and the probability that the joint is in the image. The names
// of persons and joints are JSON in the model's metadata under `cabinpose_whole`, in the same order.

#include <onnxruntime_c_api.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

const OrtApi* const ort = OrtGetApiBase()->GetApi(ORT_API_VERSION);

void check(OrtStatus* status) {
  if (status == nullptr) return;
  const std::string message = ort->GetErrorMessage(status);
  ort->ReleaseStatus(status);
  throw std::runtime_error(message);
}

struct Image {
  std::int64_t width = 0, height = 0;
  std::vector<std::uint16_t> pixels;
};

Image read_pgm(const char* path) {
  std::ifstream file(path, std::ios::binary);
  std::string kind;
  Image image;
  int greatest = 0;
  file >> kind >> image.width >> image.height >> greatest;
  file.get();
  if (!file || kind != "P5" || greatest < 256 || greatest > 65535 || image.width < 1 || image.height < 1)
    throw std::runtime_error(std::string(path) + " is no binary PGM file of 16 bits");
  std::vector<unsigned char> bytes(2 * static_cast<std::size_t>(image.width * image.height));
  if (!file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size())))
    throw std::runtime_error(std::string(path) + " is cut short");
  for (std::size_t i = 0; i < bytes.size(); i += 2)  // PGM has the high byte first
    image.pixels.push_back(static_cast<std::uint16_t>(bytes[i] << 8 | bytes[i + 1]));
  return image;
}

template <class T>
OrtValue* tensor(const OrtMemoryInfo* memory, std::vector<T>& values, const std::vector<std::int64_t>& shape,
                 ONNXTensorElementDataType type) {
  OrtValue* made = nullptr;
  check(ort->CreateTensorWithDataAsOrtValue(memory, values.data(), values.size() * sizeof(T), shape.data(), shape.size(), type,
                                            &made));
  return made;
}

int run(int argc, char** argv) {
  if (argc != 8 && argc != 13) {
    std::fprintf(stderr, "usage: %s WHOLE.onnx DEPTH.pgm AMPLITUDE.pgm FX FY CX CY [K1 K2 P1 P2 K3]\n", argv[0]);
    return 2;
  }
  Image depth = read_pgm(argv[2]), amplitude = read_pgm(argv[3]);
  if (depth.width != amplitude.width || depth.height != amplitude.height)
    throw std::runtime_error("depth and amplitude are of different sizes");
  std::vector<double> k = {std::atof(argv[4]), 0, std::atof(argv[6]), 0, std::atof(argv[5]), std::atof(argv[7]), 0, 0, 1};
  std::vector<double> lens(5, 0.0);
  for (int i = 8; i < argc; ++i) lens[static_cast<std::size_t>(i - 8)] = std::atof(argv[i]);

  OrtEnv* env = nullptr;
  OrtSessionOptions* options = nullptr;
  OrtSession* session = nullptr;
  OrtMemoryInfo* memory = nullptr;
  check(ort->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "joints", &env));
  check(ort->CreateSessionOptions(&options));
  check(ort->CreateSession(env, argv[1], options, &session));
  check(ort->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &memory));

  const std::vector<std::int64_t> size = {1, depth.height, depth.width};
  const std::array<const char*, 4> names = {"camera_k", "camera_dist", "depth", "amplitude"};
  const std::array<OrtValue*, 4> inputs = {
      tensor(memory, k, {3, 3}, ONNX_TENSOR_ELEMENT_DATA_TYPE_DOUBLE),
      tensor(memory, lens, {5}, ONNX_TENSOR_ELEMENT_DATA_TYPE_DOUBLE),
      tensor(memory, depth.pixels, size, ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT16),
      tensor(memory, amplitude.pixels, size, ONNX_TENSOR_ELEMENT_DATA_TYPE_UINT16),
  };
  std::size_t count = 0;
  check(ort->SessionGetInputCount(session, &count));  // three where a model reads depth alone
  const std::array<const char*, 2> asked = {"joints_3d", "presence"};
  std::array<OrtValue*, 2> found = {nullptr, nullptr};
  check(ort->Run(session, nullptr, names.data(), inputs.data(), count, asked.data(), asked.size(), found.data()));

  OrtTensorTypeAndShapeInfo* info = nullptr;
  std::array<std::int64_t, 4> shape = {};  // frames, persons, joints, xyz
  float *joints = nullptr, *presence = nullptr;
  check(ort->GetTensorTypeAndShape(found[0], &info));
  check(ort->GetDimensions(info, shape.data(), shape.size()));
  check(ort->GetTensorMutableData(found[0], reinterpret_cast<void**>(&joints)));
  check(ort->GetTensorMutableData(found[1], reinterpret_cast<void**>(&presence)));
  for (std::int64_t person = 0, i = 0; person < shape[1]; ++person)
    for (std::int64_t joint = 0; joint < shape[2]; ++joint, ++i)
      std::printf("%d %d %.6f %.6f %.6f %.4f\n", static_cast<int>(person), static_cast<int>(joint), joints[3 * i],
                  joints[3 * i + 1], joints[3 * i + 2], presence[i]);

  ort->ReleaseTensorTypeAndShapeInfo(info);
  for (OrtValue* value : {found[0], found[1], inputs[0], inputs[1], inputs[2], inputs[3]}) ort->ReleaseValue(value);
  ort->ReleaseMemoryInfo(memory);
  ort->ReleaseSession(session);
  ort->ReleaseSessionOptions(options);
  ort->ReleaseEnv(env);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
}
