// Takes images from a topic of ROS 2 by Fast DDS, and prints a line for each: stamp, encoding, size, CRC-32 of the pixels.
//
// subscriber DOMAIN TOPIC best_effort|reliable SECONDS

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include "ImagePubSubTypes.h"

using namespace eprosima::fastdds::dds;
using sensor_msgs::msg::dds_::Image_;

namespace {

std::array<std::uint32_t, 256> crc_table() {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t byte = 0; byte < 256; ++byte) {
        std::uint32_t value = byte;
        for (int bit = 0; bit < 8; ++bit) value = value & 1 ? 0xEDB88320U ^ value >> 1 : value >> 1;
        table[byte] = value;
    }
    return table;
}

std::uint32_t crc32(const std::vector<std::uint8_t>& bytes) {
    static const auto table = crc_table();
    std::uint32_t value = ~0U;
    for (std::uint8_t byte : bytes) value = table[(value ^ byte) & 0xFF] ^ value >> 8;
    return ~value;
}

struct Printer : DataReaderListener {
    void on_subscription_matched(DataReader*, const SubscriptionMatchedStatus& status) override {
        std::cout << "matched " << status.current_count << std::endl;
    }

    void on_data_available(DataReader* reader) override {
        Image_ image;
        SampleInfo info;
        while (reader->take_next_sample(&image, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            const auto& stamp = image.header().stamp();
            std::cout << "image " << stamp.sec() << ' ' << stamp.nanosec() << ' ' << image.encoding() << ' '
                      << image.width() << ' ' << image.height() << ' ' << crc32(image.data()) << '\n';
        }
    }
};

// UDP with room for several images, and with ROS_LOCALHOST_ONLY, as rmw_fastrtps has it, by loopback alone.
DomainParticipantQos participant_qos() {
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->receiveBufferSize = 4 << 20;
    const char* local = std::getenv("ROS_LOCALHOST_ONLY");
    if (local != nullptr && std::string(local) == "1") transport->interfaceWhiteList.emplace_back("127.0.0.1");
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    return qos;
}

}  // namespace

int main(int, char** arguments) {
    const int domain = std::atoi(arguments[1]);
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(domain, participant_qos());
    TypeSupport type(new sensor_msgs::msg::dds_::Image_PubSubType());
    type.register_type(participant);
    auto* topic = participant->create_topic(arguments[2], type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    const bool reliable = std::string(arguments[3]) == "reliable";
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.history().depth = 5;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    Printer printer;
    subscriber->create_datareader(topic, qos, &printer);
    std::this_thread::sleep_for(std::chrono::duration<double>(std::atof(arguments[4])));
    std::cout << "end" << std::endl;
    std::_Exit(0);
}
